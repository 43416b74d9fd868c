"""One rig of two cameras, and the files that hold it, written by hand in each program's own layout.

The world is in metres with y up. `left` stands at (0.5, 1, 4) and looks along -z; `right` stands at (4, 1, 0.5) and
looks along -x. In OpenCV's convention the principal points are (479.5, 269.5) and (319.5, 239.5): half a pixel less
than in ours.
"""

from pathlib import Path

import numpy as np

from jaxmocap.camera import Cameras

NAMES = ("left", "right")
SIZES = [(960, 540), (640, 480)]
INTRINSICS = [[[900, 0, 480], [0, 901, 270], [0, 0, 1]], [[600, 0, 320], [0, 602, 240], [0, 0, 1]]]
DISTORTION = [[0, 0, 0, 0, 0], [0.1, -0.2, 0.003, 0.004, 0.05]]
POSES = [
    [[1, 0, 0, -0.5], [0, -1, 0, 1], [0, 0, -1, 4], [0, 0, 0, 1]],
    [[0, 0, -1, 0.5], [0, -1, 0, 1], [-1, 0, 0, 4], [0, 0, 0, 1]],
]

ANIPOSELIB = """\
[cam_0]
name = "left"
size = [ 960, 540,]
matrix = [ [ 900.0, 0.0, 479.5,], [ 0.0, 901.0, 269.5,], [ 0.0, 0.0, 1.0,],]
distortions = [ 0.0, 0.0, 0.0, 0.0, 0.0,]
rotation = [ 3.141592653589793, 0.0, 0.0,]
translation = [ -0.5, 1.0, 4.0,]

[cam_1]
name = "right"
size = [ 640, 480,]
matrix = [ [ 600.0, 0.0, 319.5,], [ 0.0, 602.0, 239.5,], [ 0.0, 0.0, 1.0,],]
distortions = [ 0.1, -0.2, 0.003, 0.004, 0.05,]
rotation = [ 2.221441469079183, 0.0, -2.221441469079183,]
translation = [ 0.5, 1.0, 4.0,]

[metadata]
adjusted = false
error = 0.5
"""

FREEMOCAP = """\
[cam_0]
name = "left"
size = [ 960, 540,]
matrix = [ [ 900.0, 0.0, 479.5,], [ 0.0, 901.0, 269.5,], [ 0.0, 0.0, 1.0,],]
distortions = [ 0.0, 0.0, 0.0, 0.0, 0.0,]
rotation = [ 3.141592653589793, 0.0, 0.0,]
translation = [ -500.0, 1000.0, 4000.0,]
world_orientation = [ [ 1.0, 0.0, 0.0,], [ 0.0, -1.0, 0.0,], [ 0.0, 0.0, -1.0,],]
world_position = [ 500.0, 1000.0, 4000.0,]

[cam_1]
name = "right"
size = [ 640, 480,]
matrix = [ [ 600.0, 0.0, 319.5,], [ 0.0, 602.0, 239.5,], [ 0.0, 0.0, 1.0,],]
distortions = [ 0.1, -0.2, 0.003, 0.004, 0.05,]
rotation = [ 2.221441469079183, 0.0, -2.221441469079183,]
translation = [ 500.0, 1000.0, 4000.0,]
world_orientation = [ [ 0.0, 0.0, -1.0,], [ 0.0, -1.0, 0.0,], [ -1.0, 0.0, 0.0,],]
world_position = [ 4000.0, 1000.0, 500.0,]

[metadata]
charuco_square_size = 58.0
charuco_board_object = "7x5 Charuco"
path_to_recorded_videos = "recording"
date_time_calibrated = "2025-01-01T12:00:00"
"""

EASYMOCAP_INTRI = """\
%YAML:1.0
---
names:
  - "left"
  - "right"
K_left: !!opencv-matrix
  rows: 3
  cols: 3
  dt: d
  data: [900.000000, 0.000000, 479.500000, 0.000000, 901.000000, 269.500000, 0.000000, 0.000000, 1.000000]
dist_left: !!opencv-matrix
  rows: 1
  cols: 5
  dt: d
  data: [0.000000, 0.000000, 0.000000, 0.000000, 0.000000]
H_left: 540
W_left: 960
K_right: !!opencv-matrix
  rows: 3
  cols: 3
  dt: d
  data: [600.000000, 0.000000, 319.500000, 0.000000, 602.000000, 239.500000, 0.000000, 0.000000, 1.000000]
dist_right: !!opencv-matrix
  rows: 1
  cols: 5
  dt: d
  data: [0.100000, -0.200000, 0.003000, 0.004000, 0.050000]
H_right: 480
W_right: 640
"""

EASYMOCAP_EXTRI = """\
%YAML:1.0
---
names:
  - "left"
  - "right"
R_left: !!opencv-matrix
  rows: 3
  cols: 1
  dt: d
  data: [3.141593, 0.000000, 0.000000]
Rot_left: !!opencv-matrix
  rows: 3
  cols: 3
  dt: d
  data: [1.000000, 0.000000, 0.000000, 0.000000, -1.000000, 0.000000, 0.000000, 0.000000, -1.000000]
T_left: !!opencv-matrix
  rows: 3
  cols: 1
  dt: d
  data: [-0.500000, 1.000000, 4.000000]
R_right: !!opencv-matrix
  rows: 3
  cols: 1
  dt: d
  data: [2.221441, 0.000000, -2.221441]
Rot_right: !!opencv-matrix
  rows: 3
  cols: 3
  dt: d
  data: [0.000000, 0.000000, -1.000000, 0.000000, -1.000000, 0.000000, -1.000000, 0.000000, 0.000000]
T_right: !!opencv-matrix
  rows: 3
  cols: 1
  dt: d
  data: [0.500000, 1.000000, 4.000000]
"""

# The right camera's video shows a part of its sensor that begins at the pixel (100, 20).
QUALISYS = """\
<?xml version="1.0" encoding="UTF-8"?>
<calibration calibrated="true" source="20250101_120000.qca" created="Calibration carried out: 2025-01-01 12:00:00"
    qtm-version="2024.3 (build 14360)" type="regular" wandLength="601.100000" maximumFrames="1500">
  <results std-dev="1.959473" min-max-diff="41.064426"/>
  <cameras>
    <camera active="1" calibrated="true" message="" point-count="100" avg-residual="0.4" serial="left"
        model="Miqus Video" viewrotation="0" video_resolution="1080p">
      <fov_marker left="0" top="0" right="959" bottom="539"/>
      <fov_marker_max left="0" top="0" right="959" bottom="539"/>
      <fov_video left="0" top="0" right="959" bottom="539"/>
      <fov_video_max left="0" top="0" right="959" bottom="539"/>
      <transform x="500.0" y="1000.0" z="4000.0" r11="1.0" r12="0.0" r13="0.0" r21="0.0" r22="1.0" r23="0.0"
          r31="0.0" r32="0.0" r33="1.0"/>
      <intrinsic focallength="9.3" sensorMinU="0.0" sensorMaxU="61439.0" sensorMinV="0.0" sensorMaxV="34559.0"
          focalLengthU="57600.0" focalLengthV="57664.0" centerPointU="30688.0" centerPointV="17248.0" skew="0.0"
          radialDistortion1="0.0" radialDistortion2="0.0" radialDistortion3="0.0"
          tangentalDistortion1="0.0" tangentalDistortion2="0.0"/>
    </camera>
    <camera active="1" calibrated="true" message="" point-count="100" avg-residual="0.4" serial="right"
        model="Miqus Video" viewrotation="0" video_resolution="1080p">
      <fov_marker left="0" top="0" right="799" bottom="599"/>
      <fov_marker_max left="0" top="0" right="799" bottom="599"/>
      <fov_video left="100" top="20" right="739" bottom="499"/>
      <fov_video_max left="0" top="0" right="799" bottom="599"/>
      <transform x="4000.0" y="1000.0" z="500.0" r11="0.0" r12="0.0" r13="-1.0" r21="0.0" r22="1.0" r23="0.0"
          r31="1.0" r32="0.0" r33="0.0"/>
      <intrinsic focallength="9.3" sensorMinU="0.0" sensorMaxU="51199.0" sensorMinV="0.0" sensorMaxV="38399.0"
          focalLengthU="38400.0" focalLengthV="38528.0" centerPointU="26848.0" centerPointV="16608.0" skew="0.0"
          radialDistortion1="0.1" radialDistortion2="-0.2" radialDistortion3="0.05"
          tangentalDistortion1="0.003" tangentalDistortion2="0.004"/>
    </camera>
  </cameras>
</calibration>
"""

OPENCV_YAML = """\
%YAML:1.0
---
left:
   image_width: 960
   image_height: 540
   camera_matrix: !!opencv-matrix
      rows: 3
      cols: 3
      dt: d
      data: [ 9.0000000000000000e+02, 0., 4.7950000000000000e+02, 0.,
          9.0100000000000000e+02, 2.6950000000000000e+02, 0., 0., 1. ]
   distortion_coefficients: !!opencv-matrix
      rows: 5
      cols: 1
      dt: d
      data: [ 0., 0., 0., 0., 0. ]
   rvec: !!opencv-matrix
      rows: 3
      cols: 1
      dt: d
      data: [ 3.1415926535897931e+00, 0., 0. ]
   tvec: !!opencv-matrix
      rows: 3
      cols: 1
      dt: d
      data: [ -5.0000000000000000e-01, 1., 4. ]
right:
   image_width: 640
   image_height: 480
   camera_matrix: !!opencv-matrix
      rows: 3
      cols: 3
      dt: d
      data: [ 600., 0., 319.5, 0., 602., 239.5, 0., 0., 1. ]
   distortion_coefficients: !!opencv-matrix
      rows: 1
      cols: 5
      dt: d
      data: [ 1.0000000000000001e-01, -2.0000000000000001e-01, 3.0000000000000001e-03, 4.0000000000000001e-03, 0.05 ]
   R: !!opencv-matrix
      rows: 3
      cols: 3
      dt: d
      data: [ 0., 0., -1., 0., -1., 0., -1., 0., 0. ]
   T: !!opencv-matrix
      rows: 3
      cols: 1
      dt: d
      data: [ 0.5, 1., 4. ]
"""

OPENCV_XML = """\
<?xml version="1.0"?>
<opencv_storage>
<camera_0>
  <name>left</name>
  <image_size>
    960 540</image_size>
  <K type_id="opencv-matrix">
    <rows>3</rows>
    <cols>3</cols>
    <dt>d</dt>
    <data>
      900. 0. 479.5 0. 901. 269.5 0. 0. 1.</data></K>
  <rvec>
    3.1415926535897931 0. 0.</rvec>
  <tvec>
    -0.5 1. 4.</tvec></camera_0>
<camera_1>
  <name>"right"</name>
  <image_size>
    640 480</image_size>
  <K type_id="opencv-matrix">
    <rows>3</rows>
    <cols>3</cols>
    <dt>d</dt>
    <data>
      600. 0. 319.5 0. 602. 239.5
      0. 0. 1.</data></K>
  <D>
    0.1 -0.2 3.e-03 4.e-03 5.e-02</D>
  <rvec>
    2.221441469079183 0. -2.221441469079183</rvec>
  <tvec>
    0.5 1. 4.</tvec></camera_1>
</opencv_storage>
"""

OPENCV_JSON = """\
{
    "left": {
        "size": [960, 540],
        "cameraMatrix": [[900, 0, 479.5], [0, 901, 269.5], [0, 0, 1]],
        "R": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
        "t": [-0.5, 1, 4]
    },
    "right": {
        "size": [640, 480],
        "cameraMatrix": {
            "type_id": "opencv-matrix", "rows": 3, "cols": 3, "dt": "d",
            "data": [600.0, 0.0, 319.5, 0.0, 602.0, 239.5, 0.0, 0.0, 1.0]
        },
        "distCoeffs": [0.1, -0.2, 0.003, 0.004, 0.05],
        "R": [[0, 0, -1], [0, -1, 0], [-1, 0, 0]],
        "t": [0.5, 1, 4]
    }
}
"""

OPENPOSE_XML = """\
<?xml version="1.0"?>
<opencv_storage>
<CameraMatrix type_id="opencv-matrix">
  <rows>3</rows>
  <cols>4</cols>
  <dt>d</dt>
  <data>
    {pose}</data></CameraMatrix>
<Intrinsics type_id="opencv-matrix">
  <rows>3</rows>
  <cols>3</cols>
  <dt>d</dt>
  <data>
    {matrix}</data></Intrinsics>
<Distortion type_id="opencv-matrix">
  <rows>8</rows>
  <cols>1</cols>
  <dt>d</dt>
  <data>
    {distortion} 0. 0. 0.</data></Distortion>
</opencv_storage>
"""

FILES = {
    "aniposelib": {"calibration.toml": ANIPOSELIB},
    "freemocap": {"recording_camera_calibration.toml": FREEMOCAP},
    "easymocap": {"calib/intri.yml": EASYMOCAP_INTRI, "calib/extri.yml": EASYMOCAP_EXTRI},
    "qualisys": {"calibration.qca.txt": QUALISYS},
    "opencv-yaml": {"rig.yml": OPENCV_YAML},
    "opencv-xml": {"rig.xml": OPENCV_XML},
    "opencv-json": {"rig.json": OPENCV_JSON},
    "openpose": {
        f"cameraParameters/{name}.xml": OPENPOSE_XML.format(
            pose=" ".join(str(float(value)) for row in POSES[i][:3] for value in row),
            matrix=" ".join(map(str, [*INTRINSICS[i][0][:2], centre[0], *INTRINSICS[i][1][:2], centre[1], 0, 0, 1])),
            distortion=" ".join(map(str, DISTORTION[i])),
        )
        for i, (name, centre) in enumerate(zip(NAMES, [(479.5, 269.5), (319.5, 239.5)], strict=True))
    },
}


def put(folder: Path, form: str, changes: tuple[str, str] | None = None, file: str | None = None) -> Path:
    """Write the files of one form, with one text replaced in all or in one of them; the path for capture.toml."""
    for name, text in FILES[form].items():
        if changes is not None and file in (None, name):
            assert changes[0] in text, f"{name} has no {changes[0]}"
            text = text.replace(*changes, 1)
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text)
    first = next(iter(FILES[form]))
    return folder / (first.split("/")[0] if "/" in first else first)


def check_rig(cameras: Cameras, tolerance: float = 1e-6) -> None:
    """That these are the cameras of the files."""
    assert cameras.names == NAMES
    assert list(cameras.sizes) == SIZES
    np.testing.assert_allclose(cameras.intrinsics, INTRINSICS, rtol=0, atol=1e-4)
    np.testing.assert_allclose(cameras.distortion, DISTORTION, rtol=0, atol=1e-7)
    for frame in range(cameras.num_frames):
        np.testing.assert_allclose(cameras.cam_from_world[:, frame], POSES, rtol=0, atol=tolerance)
