"""Following one person through the pictures of a video."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64, Int64, UInt8

from ._left_right import exchanged_sides, layout_of, mirrored_points
from ._outliers import without_outliers
from ._person_model import PersonModel, Sighting
from ._region import Region
from ._unfinished import SeenSoFar

_PRESENT = 0.5  # below, nobody is there (MediaPipe's min_tracking_confidence)
_REACH = 0.5  # sides of the region by which a person who was lost may be elsewhere, and as much per picture since
_MOVED = 0.08  # share of the region's side by which points do not move from picture to picture without being doubted
_TURN = 0.35  # radians
_CHECKED = 12  # pictures from one fresh finding to the next
_SAME_PLACE = 0.15  # sides of the region within which someone found is the person who is followed
_LONG = 15  # pictures after which a person who was lost may be anywhere, and is searched for thoroughly as rarely


@dataclass(frozen=True)
class FollowedPerson:
    """One person's keypoints in the pictures of a video.

    Attributes:
        frames: numbers of the pictures in the video.
        points: x, y (pixels) and confidence in the order of the model's layout; 0 where nothing was found or believed.
        scores: the confidences the model gave, also of points that are not believed.
        sides: of the regions looked at, pixels; 0 where nobody was found.
        notes: sentences on what was chosen and where nobody was found.
    """

    frames: Int64[np.ndarray, " frame"]
    points: Float64[np.ndarray, "frame point 3"]
    scores: Float64[np.ndarray, "frame point"]
    sides: Float64[np.ndarray, " frame"]
    notes: tuple[str, ...]

    @property
    def found(self) -> Bool[np.ndarray, " frame"]:
        """In which pictures the person was found."""
        return self.sides > 0

    def joined(self, later: "FollowedPerson") -> "FollowedPerson":
        """Join the pictures of both, in order; of those that both have, the later's."""
        if not self.points.size or not later.points.size:
            return later if later.points.size else self
        kept = ~np.isin(self.frames, later.frames)
        frames = np.concatenate([self.frames[kept], later.frames])
        order = np.argsort(frames, kind="stable")
        points, scores, sides = (
            np.concatenate([getattr(self, name)[kept], getattr(later, name)])[order]
            for name in ("points", "scores", "sides")
        )
        return FollowedPerson(frames[order], points, scores, sides, later.notes)


def follow_person(
    pictures: Iterable[UInt8[np.ndarray, "height width 3"]],
    model: PersonModel,
    *,
    at: tuple[float, float] | None = None,
    frames: Sequence[int] | None = None,
    silhouette: Callable[[int, Bool[np.ndarray, "height width"]], None] | None = None,
    begun: SeenSoFar | None = None,
    keep: Callable[[SeenSoFar], None] = lambda seen: None,
) -> FollowedPerson:
    """Find one person's keypoints in the RGB pictures of a video, in order of time.

    The person is the one who holds the pixel `at` of the first picture in which people are found, or is nearest to it;
    without, the largest, and `notes` say so where there are others. Points that jump away for a single picture, and
    those outside the picture, get confidence 0. `frames` are the pictures' numbers in the video, by default from 0.
    `silhouette` is told each picture's number and the mask of the person in it, where the model knows one. `keep` is
    told before each picture what was seen in those before; with that as `begun`, `pictures` are the others.
    """
    begun = SeenSoFar() if begun is None else begun
    seen, notes = list(begun.seen), list(begun.notes)
    height = width = 0
    follower = _Follower(model, at, notes)
    follower.go_on(begun)
    for picture in pictures:
        keep(SeenSoFar(seen, follower.since, notes))
        height, width = picture.shape[:2]
        sighting = follower.next(picture)
        if sighting is not None and sighting.silhouette is not None:
            if silhouette is not None:
                number = len(seen) if frames is None else frames[len(seen)]
                silhouette(number, sighting.silhouette.in_picture((height, width)))
            sighting = replace(sighting, silhouette=None)
        seen.append(sighting)
    numbers = np.arange(len(seen)) if frames is None else np.asarray(frames, np.int64)
    present = [one for one in seen if one is not None]
    if not present:
        return FollowedPerson(
            numbers, np.zeros((len(seen), 0, 3)), np.zeros((len(seen), 0)), np.zeros(len(seen)), tuple(notes)
        )
    nobody = np.zeros_like(present[0].points)
    points = np.stack([nobody if one is None else one.points for one in seen])
    sides = np.array([0.0 if one is None else one.region.side for one in seen])
    return believed(FollowedPerson(numbers, points, points[..., 2], sides, tuple(notes)), (width, height))


def believed(person: FollowedPerson, size: tuple[int, int]) -> FollowedPerson:
    """Return the person with left and right as they are in most pictures, and the confidences that the model gave.

    These are 0 for points that are not believed: outside the picture of `size` (width, height), or away for a single
    picture.
    """
    points, scores = person.points.copy(), person.scores.copy()
    outside = ((points[..., :2] < 0) | (points[..., :2] > size)).any(-1)
    points[..., 2] = np.where(outside, 0.0, scores)
    if (layout := layout_of(points.shape[1])) is not None:
        exchanged, mirrored = exchanged_sides(points, person.sides, person.frames), mirrored_points(layout)
        points[exchanged], scores[exchanged] = points[exchanged][:, mirrored], scores[exchanged][:, mirrored]
    points[..., 2] = without_outliers(points, person.sides, person.frames)
    return replace(person, points=points, scores=scores)


class _Follower:
    """Whom to follow, and where that person was last."""

    def __init__(self, model: PersonModel, at: tuple[float, float] | None, notes: list[str]):
        self._model, self._at, self._notes = model, at, notes
        self._last: Sighting | None = None
        self._missed = self.since = 0

    def go_on(self, begun: SeenSoFar) -> None:
        """Know what is known after the pictures that were seen."""
        self.since = begun.since
        for sighting in begun.seen:
            self._note(sighting)

    def _note(self, sighting: Sighting | None) -> None:
        self._missed = 0 if sighting is not None else self._missed + 1
        self._last = self._last if sighting is None else sighting

    def next(self, picture: np.ndarray) -> Sighting | None:
        """Find the person in the next picture."""
        sighting = None
        if self._last is not None and not self._missed:
            sighting = self._checked(picture, self._again(picture, self._last))
        if sighting is None:
            sighting = next(self._candidates(picture), None)
        self._note(sighting)
        return sighting

    def _look(self, picture: np.ndarray, region: Region) -> Sighting | None:
        sighting = self._model.look(picture, region)
        return sighting if sighting.presence >= _PRESENT else None

    def _first(self, picture: np.ndarray, region: Region) -> Sighting | None:
        """Look twice at the person in a region that was found, for such a region is a coarse one."""
        sighting = self._look(picture, region)
        return None if sighting is None else self._again(picture, sighting)

    def _again(self, picture: np.ndarray, last: Sighting) -> Sighting | None:
        """Find the person near where the last picture showed them.

        Where the points have moved far, the square is turned otherwise and looked at again, and the answer nearest to
        the last picture's is taken: a network may see a leaning person the wrong way round, and then goes on to do so.
        """
        first = self._look(picture, last.region)
        if first is None or _change(first, last) + first.doubt < _MOVED:
            return first
        answers = [first, *self._turned(picture, last.region)]
        return min(answers, key=lambda one: _change(one, last) + one.doubt)

    def _turned(self, picture: np.ndarray, region: Region) -> list[Sighting]:
        """Answers in the same square turned otherwise; one of them stands it upright."""
        turns = (-_TURN, _TURN) if abs(region.angle) < _TURN / 2 else (-region.angle, -_TURN, _TURN)
        answers = [self._look(picture, replace(region, angle=region.angle + turn)) for turn in turns]
        return [one for one in answers if one is not None]

    def _checked(self, picture: np.ndarray, sighting: Sighting | None) -> Sighting | None:
        """Find the person anew now and then.

        Where that gives another answer, the one of several is taken that lies nearest to the others, so that a mistake
        that was followed comes to an end.
        """
        self.since += 1
        if sighting is None or self.since < _CHECKED:
            return sighting
        self.since, region = 0, sighting.region
        people = self._model.find(picture, replace(region, side=2 * region.side, angle=0.0), thorough=False)
        near = [one for one in people if _unlikeness(one, region) < _SAME_PLACE]
        likest = min(near, key=lambda one: _unlikeness(one, region), default=None)
        fresh = None if likest is None else self._look(picture, likest)
        if fresh is None or _change(fresh, sighting) < _MOVED:
            return sighting
        answers = [sighting, fresh, *self._turned(picture, fresh.region)]
        return min(answers, key=lambda one: sum(min(_change(one, other), 2 * _MOVED) for other in answers))

    def _candidates(self, picture: np.ndarray) -> Iterator[Sighting]:
        """Who may be the person, likeliest first."""
        thorough = self._missed < _LONG or self._missed % _LONG == 0
        if self._last is None:
            yield from self._choice(picture, self._model.find(picture, thorough=thorough))
            return
        last, reach, people = self._last.region, np.inf, []
        if self._missed < _LONG:
            reach = _REACH * last.side * (1 + self._missed)
            people = self._model.find(picture, replace(last, side=2 * reach + last.side, angle=0.0), thorough=False)
        people = people or self._model.find(picture, thorough=thorough)
        for region in sorted(people, key=lambda one: _unlikeness(one, last)):
            if _distance(region, *last.centre) <= reach and (sighting := self._first(picture, region)):
                yield sighting

    def _choice(self, picture: np.ndarray, people: list[Region]) -> Iterator[Sighting]:
        """Whom to begin with: everybody is looked at, so that nobody is counted who is not there."""
        seen = _one_each([sighting for region in people if (sighting := self._first(picture, region))])
        if self._at is not None:
            x, y = self._at
            seen.sort(key=lambda one: (not one.region.holds(x, y), _distance(one.region, x, y)))
        else:
            seen.sort(key=lambda one: -one.region.side)
        if len(seen) > 1:
            x, y = seen[0].region.centre
            others = " ".join(f"({one.region.centre[0]:.0f}, {one.region.centre[1]:.0f})" for one in seen[1:])
            how = "the largest" if self._at is None else "the one chosen"
            self._notes.append(f"{len(seen)} people: {how}, at ({x:.0f}, {y:.0f}), is followed, not those at {others}")
        yield from seen


def _one_each(seen: list[Sighting]) -> list[Sighting]:
    """One sighting of each person, the one most upright: a person may be found upside down too."""
    kept: list[Sighting] = []
    for one in sorted(seen, key=lambda one: -np.cos(one.region.angle)):
        if all(_distance(one.region, *other.region.centre) > _SAME_PLACE * other.region.side for other in kept):
            kept.append(one)
    return kept


def _distance(region: Region, x: float, y: float) -> float:
    return float(np.hypot(region.centre[0] - x, region.centre[1] - y))


def _unlikeness(one: Region, other: Region) -> float:
    """How far two regions lie apart, in sides, and how far they are turned: people are also found upside down."""
    return _distance(one, *other.centre) / other.side + (1 - float(np.cos(one.angle - other.angle))) / 2


def _change(sighting: Sighting, last: Sighting) -> float:
    """How far the points have moved, as a share of the region's side; a quarter of them farther."""
    moved = np.linalg.norm(sighting.points[:, :2] - last.points[:, :2], axis=-1)
    return float(np.percentile(moved, 75)) / last.region.side
