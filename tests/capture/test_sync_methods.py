"""Each way of synchronising alone, on films whose offset is known."""

import numpy as np
import pytest
from films import Film, make_film, rate

from jaxmocap.capture._video import index_video
from jaxmocap.capture.synchronisation._estimate import Estimate, Undecided, choose, solve_offsets
from jaxmocap.capture.synchronisation._flash import compare_flashes, find_flashes, measure_brightness
from jaxmocap.capture.synchronisation._motion import compare_motions, measure_motion
from jaxmocap.capture.synchronisation._person import PersonHeights, offset_by_person
from jaxmocap.capture.synchronisation._sound import RATE, Sound, compare_sounds, read_sound

SHORT = rate(30, 30)
IRREGULAR = tuple(np.cumsum(np.random.default_rng(3).uniform(0.02, 0.05, 90)).round(4))


def films_of(folder, *films, suffix=".mp4"):
    return [index_video(make_film(folder / f"{number}{suffix}", film)) for number, film in enumerate(films)]


def true_offset(first: Film, second: Film) -> float:
    return second.start + second.times[0] - first.start - first.times[0]


def by_flash(*videos) -> Estimate:
    brightness = [measure_brightness(video) for video in videos]
    return compare_flashes(*brightness, *map(find_flashes, brightness))


def by_sound(*videos) -> Estimate:
    return compare_sounds(*map(read_sound, videos))


def by_motion(*videos) -> Estimate:
    return compare_motions(*map(measure_motion, videos))


# Flash ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("moment", "frame", "line"), [(0.5, 15, 0.0), (0.51, 15, 0.4), (0.52, 15, 0.8), (0.53, 16, 0)])
def test_a_flash_is_found_by_frame_and_line(tmp_path, moment, frame, line):
    (video,) = films_of(tmp_path, Film(times=SHORT, flashes=(moment,)))
    (found,) = find_flashes(measure_brightness(video))
    assert found.frame == frame
    assert found.line == pytest.approx(line, abs=0.02)
    assert found.seconds == pytest.approx(moment, abs=0.005)


@pytest.mark.parametrize("start", [2 / 30, 0.0812, -0.0511])
@pytest.mark.parametrize(("times", "readout"), [(SHORT, 0.75), (SHORT, 0.6), (rate(50, 50), 0.45)])
def test_the_offset_by_a_flash_is_good_to_a_part_of_a_frame(tmp_path, start, times, readout):
    first = Film(times=SHORT, flashes=(0.513,))
    second = Film(start=start, times=times, readout=readout, flashes=(0.513,), shake=1)
    found = by_flash(*films_of(tmp_path, first, second))
    assert found.offset == pytest.approx(start, abs=0.17 / 30)
    assert found.confidence > 0.8


@pytest.mark.parametrize(("start", "count"), [(0.4, 1), (14 / 30, 1), (0.489, 0), (0.5, 0), (0.52, 0)])
def test_a_flash_that_may_have_begun_before_the_video_is_none(tmp_path, start, count):
    (video,) = films_of(tmp_path, Film(start=start, times=SHORT, flashes=(0.511,)))
    found = find_flashes(measure_brightness(video))
    assert [flash.seconds for flash in found] == [pytest.approx(0.511 - start, abs=0.005)] * count


@pytest.mark.parametrize("beginning", [{"black": 3}, {"fade": 12}, {"black": 3, "fade": 12}])
@pytest.mark.parametrize("flashes", [(), (1.013,)])
def test_a_black_or_faded_beginning_is_no_flash(tmp_path, beginning, flashes):
    (video,) = films_of(tmp_path, Film(times=rate(45, 30), flashes=flashes, **beginning))
    found = find_flashes(measure_brightness(video))
    assert [flash.seconds for flash in found] == [pytest.approx(moment, abs=0.005) for moment in flashes]


def test_a_picture_that_stays_brighter_is_no_flash(tmp_path):
    (video,) = films_of(tmp_path, Film(times=rate(45, 30)))
    brightness = measure_brightness(video)
    brightness.cells[20:] += 60
    assert find_flashes(brightness) == []


@pytest.mark.parametrize("rotation", [90, 180])
def test_the_lines_of_a_turned_video_are_followed_too(tmp_path, rotation):
    film = Film(times=SHORT, flashes=(0.512,), rotation=rotation)
    (found,) = find_flashes(measure_brightness(films_of(tmp_path, film)[0]))
    assert (found.frame, found.line) == (15, pytest.approx(0.48, abs=0.02))


def test_times_between_frames_that_vary_are_followed(tmp_path):
    first, second = Film(flashes=(1.013,)), Film(start=0.3, times=IRREGULAR, flashes=(1.013,))
    found = by_flash(*films_of(tmp_path, first, second))
    assert found.offset == pytest.approx(true_offset(first, second), abs=0.5 / 30)


def test_of_several_flashes_most_must_agree(tmp_path):
    first = Film(times=rate(60, 30), flashes=(0.3, 0.9, 1.7))
    second = Film(start=0.2, times=rate(60, 30), flashes=(0.9, 1.2, 1.7))
    videos = films_of(tmp_path, first, second)
    found = by_flash(*videos)
    assert found.offset == pytest.approx(0.2, abs=0.005)
    assert len(found.detail["frames"]) == 2
    assert found.confidence < 0.6
    (once,) = films_of(tmp_path / "..", Film(times=rate(60, 30), flashes=(0.5,)))
    with pytest.raises(Undecided, match=r"3 and 1 flashes, which fit in several ways"):
        by_flash(videos[0], once)


def test_a_person_who_steps_into_the_picture_is_no_flash(tmp_path):
    (video,) = films_of(tmp_path, Film(shake=6))
    assert find_flashes(measure_brightness(video)) == []
    with pytest.raises(Undecided, match=r"0\.mp4 and 0\.mp4 have no flash"):
        by_flash(video, video)


# Sound ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("start", [0.0, 0.7655, -1.1])
def test_the_offset_by_sound_is_good_to_a_thousandth_of_a_second(tmp_path, start):
    still = {"moves": False, "times": rate(10, 4), "sound": "noise"}
    first = Film(start=3, **still)
    second = Film(start=3 + start, **still, sound_rate=44_100, channels="stereo")
    found = by_sound(*films_of(tmp_path, first, second))
    assert found.offset == pytest.approx(start, abs=0.001)
    assert found.confidence > 0.7


def test_sound_counts_on_the_clock_of_the_pictures(tmp_path):
    late_sound = Film(start=2, times=rate(12, 4), sound="noise", sound_late=0.25)
    late_pictures = Film(start=1.5, times=tuple(t + 0.4 for t in rate(12, 4)), sound="noise", sound_rate=32_000)
    videos = films_of(tmp_path, late_sound, late_pictures, suffix=".mkv")
    assert [read_sound(video).start for video in videos] == pytest.approx([0.25, -0.4], abs=0.001)
    assert by_sound(*videos).offset == pytest.approx(true_offset(late_sound, late_pictures), abs=0.001)


def test_the_drift_of_clocks_is_measured_over_long_clips(tmp_path):
    long = {"moves": False, "times": rate(45, 1), "sound": "noise"}
    first, second = Film(start=1, **long), Film(start=3.5, **long, drift=120e-6)
    found = by_sound(*films_of(tmp_path, first, second))
    assert found.drift == pytest.approx(120e-6, abs=6e-6)
    assert found.offset == pytest.approx(2.5 + 120e-6 * found.when, abs=0.0005)
    assert found.at(0.0) == pytest.approx(2.5, abs=0.0007)
    assert found.detail["windows"] >= 6


def test_drift_needs_no_loud_and_clean_sound():
    random = np.random.default_rng(5)
    source = random.normal(size=80 * RATE).astype(np.float32)
    own = np.arange(60 * RATE) / RATE
    second = np.interp((own * (1 - 90e-6) + 12.5) * RATE, np.arange(len(source)), source)
    tracks = [source[5 * RATE : 65 * RATE], second]
    noisy = [(track + random.normal(size=len(track))).astype(np.float32) for track in tracks]
    found = compare_sounds(Sound("a", noisy[0], 0.0), Sound("b", noisy[1], 0.0))
    assert found.drift == pytest.approx(-90e-6, abs=5e-6)
    assert found.at(0.0) == pytest.approx(7.5, abs=0.001)


def test_one_clap_alone_is_found_but_not_believed_before_anything_else():
    random = np.random.default_rng(2)
    clap = random.normal(size=800) * np.exp(-np.arange(800) / 150)
    tracks = [random.normal(0, 0.05, 4 * RATE).astype(np.float32) for _ in range(2)]
    for track, begin in zip(tracks, (30_000, 22_000), strict=True):
        track[begin : begin + 800] += clap.astype(np.float32)
    found = compare_sounds(Sound("a", tracks[0], 0.0), Sound("b", tracks[1], 0.0))
    assert found.offset == pytest.approx(0.5, abs=0.0005)
    assert found.confidence < 0.3
    pair = chosen({"sound": found, **estimates(motion=0.9)})
    assert pair.chosen.method == "motion"
    alone = choose((0, 1), ("a", "b"), {"sound": found}, {}, 1 / 60, 1 / 30)
    (note,) = solve_offsets([alone], ("a", "b"), 1 / 60, 1 / 30)[1]
    assert note.startswith("a and b: sound alone decided, with a confidence of only 0.")


@pytest.mark.parametrize(
    ("first", "second", "sentence"),
    [
        ("noise", None, r"1\.mp4 has no sound"),
        ("silence", "noise", r"0\.mp4 is silent"),
        ("noise", "other", r"sound of 0\.mp4 fits that of 1\.mp4 nowhere better"),
        ("beeps", "noise", r"sound of 0\.mp4 repeats itself after 0\.50 s"),
    ],
)
def test_sound_that_cannot_decide_says_why(tmp_path, first, second, sentence):
    films = (Film(start=5, times=rate(8, 2), moves=False, sound=sound) for sound in (first, second))
    with pytest.raises(Undecided, match=sentence):
        by_sound(*films_of(tmp_path, *films))


def test_too_little_sound_is_refused(tmp_path):
    films = (Film(start=5, times=times, moves=False, sound="noise") for times in (rate(8, 2), rate(3, 10)))
    with pytest.raises(Undecided, match=r"1\.mp4 has only 0\.\d+ s of sound"):
        by_sound(*films_of(tmp_path, *films))


# Motion -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("times", [rate(110, 30), rate(90, 24), IRREGULAR])
def test_the_offset_by_motion_is_good_to_half_a_frame(tmp_path, times):
    first, second = Film(start=2, times=rate(120, 30)), Film(start=2.71, times=times, shake=2)
    found = by_motion(*films_of(tmp_path, first, second))
    assert found.offset == pytest.approx(true_offset(first, second), abs=0.5 / 30)
    assert found.confidence > 0.99


def test_a_flash_does_not_count_as_motion(tmp_path):
    first = Film(start=2, times=rate(120, 30), flashes=(3.6,))
    second = Film(start=2.4, times=rate(120, 30), flashes=(4.9,))
    videos = films_of(tmp_path, first, second)
    curves = [measure_motion(v, [f.frame for f in find_flashes(measure_brightness(v))]) for v in videos]
    assert compare_motions(*curves).offset == pytest.approx(0.4, abs=0.5 / 30)


@pytest.mark.parametrize(
    ("second", "sentence"),
    [
        (Film(start=2.7, times=rate(120, 30), backwards=True), "too little alike"),
        (Film(start=2.7, times=rate(60, 30), moves=False), r"nothing moves in 1\.mp4"),
        (Film(start=2.7, times=rate(20, 30)), r"1\.mp4 is shorter than 1 s"),
    ],
)
def test_motion_that_cannot_decide_says_why(tmp_path, second, sentence):
    with pytest.raises(Undecided, match=sentence):
        by_motion(*films_of(tmp_path, Film(start=2, times=rate(120, 30)), second))


def test_unrelated_motions_are_taken_for_the_same_less_than_once_in_twenty(tmp_path):
    (video,) = films_of(tmp_path, Film(times=rate(120, 30)))
    random, wrong = np.random.default_rng(11), 0
    curve = measure_motion(video)
    for _ in range(60):
        one, other = (
            type(curve)(video, curve.seconds, np.cumsum(random.normal(size=curve.values.shape), axis=0) * 0.01)
            for _ in range(2)
        )
        try:
            compare_motions(one, other)
            wrong += 1
        except Undecided:
            continue
    assert wrong <= 3


# Choosing ---------------------------------------------------------------------------------------------------------


def estimates(**offsets: float) -> dict:
    return {method: Estimate(method, offset, 0.9, when=1.0) for method, offset in offsets.items()}


def chosen(found: dict):
    return choose((0, 1), ("left", "right"), found, {}, tolerance=1 / 60, frame=1 / 30)


def test_two_that_agree_are_believed_against_a_third():
    pair = chosen(estimates(flash=-0.2, sound=0.5, motion=0.51))
    assert pair.chosen.method == "sound"
    assert pair.notes == (
        "left and right: the offset in frames is +15.00 by sound, and motion agrees, but it is -6.00 by flash: sound "
        "is used; choose another with --method",
    )


def test_one_in_between_does_not_reconcile_two_that_disagree():
    pair = chosen(estimates(flash=0.5, sound=0.5 + 0.8 / 30, motion=0.5 + 0.4 / 30))
    assert pair.chosen.method == "flash"
    assert "but it is +15.80 by sound" in pair.notes[0]


def test_without_a_majority_flash_goes_before_sound_before_motion():
    assert chosen(estimates(flash=0.0, sound=0.5, motion=1.0)).chosen.method == "flash"
    assert chosen(estimates(sound=0.5, motion=1.0)).chosen.method == "sound"
    assert len(chosen(estimates(sound=0.5, motion=1.0)).notes) == 1
    assert chosen({}).chosen is None


def test_agreement_within_half_a_frame_needs_no_note():
    pair = chosen(estimates(flash=0.5, sound=0.5 + 0.49 / 30, motion=0.5 - 0.49 / 30))
    assert (pair.chosen.offset, pair.notes, pair.confirmed) == (0.5, (), True)


def test_a_flash_at_the_beginning_is_carried_to_the_middle_by_the_drift_that_sound_knows():
    found = estimates(flash=2.0)
    found["sound"] = Estimate("sound", 2.03, 0.9, when=301.0, drift=1e-4, detail={"shared_seconds": 600.0})
    pair = chosen(found)
    assert (pair.chosen.method, pair.chosen.when) == ("flash", 301.0)
    assert pair.chosen.offset == pytest.approx(2.03)
    assert "drift apart by 1.8 frames" in pair.notes[0]


def pair_of(first: int, second: int, **offsets: float):
    names = ("a", "b", "c")
    return choose((first, second), (names[first], names[second]), estimates(**offsets), {}, 1 / 60, 1 / 30)


def test_offsets_follow_the_surest_pairs_and_the_rest_is_checked():
    pairs = [pair_of(0, 1, flash=0.4, sound=0.4), pair_of(0, 2, motion=0.8), pair_of(1, 2, flash=0.5, sound=0.5)]
    offsets, notes = solve_offsets(pairs, ("a", "b", "c"), 1 / 60, 1 / 30)
    assert offsets == pytest.approx([0.0, 0.4, 0.9])
    assert len(notes) == 1
    assert notes[0].startswith("a and c by motion do not fit the surer pairs: -3.00 frames remain")
    backwards = [pair_of(0, 2, sound=-0.7), pair_of(1, 2, sound=0.1)]
    assert solve_offsets(backwards, ("a", "b", "c"), 1 / 60, 1 / 30)[0] == pytest.approx([0.0, -0.8, -0.7])


def person_seen(start: float, count: int, side: float, noise: np.random.Generator) -> PersonHeights:
    """Nine points that go up and down, each in its own way, at 30 pictures a second; a few are not seen."""
    times = start + np.arange(count) / 30
    speeds, phases = np.linspace(2, 9, 9), np.linspace(0, 5, 9)
    heights = np.sin(np.multiply.outer(times, speeds) + phases) * side + 0.1 * noise.standard_normal((count, 9))
    heights[noise.random((count, 9)) < 0.1] = np.nan
    return PersonHeights(np.arange(count) / 30, heights)


def test_a_person_tells_when_a_video_began_and_another_person_does_not():
    noise = np.random.default_rng(0)
    first, second = person_seen(0.0, 90, 1.0, noise), person_seen(0.42, 80, 0.8, noise)
    found = offset_by_person(first, second)
    assert found is not None
    assert found.sure
    assert found.seconds == pytest.approx(0.42, abs=0.01)
    stranger = PersonHeights(second.seconds, noise.standard_normal((80, 9)).cumsum(0))
    other = offset_by_person(first, stranger)
    assert other is not None
    assert not other.sure
    assert offset_by_person(first, PersonHeights(second.seconds[:9], second.heights[:9])) is None
