"""A detector's keypoints: layouts of points as data, readers of the files that programs write, and models that find a
person in pictures and follow one through a video."""

from ._cards import CARDS as CARDS, ModelCard as ModelCard, ModelName as ModelName
from ._files import (
    VideoKeypoints as VideoKeypoints,
    farthest_outside as farthest_outside,
    write_body_25 as write_body_25,
)
from ._follow import FollowedPerson as FollowedPerson, believed as believed, follow_person as follow_person
from ._layouts import (
    BODY_25 as BODY_25,
    LAYOUTS as LAYOUTS,
    Layout as Layout,
    LayoutName as LayoutName,
    to_body_25 as to_body_25,
)
from ._open_model import open_model as open_model
from ._person_file import read_person as read_person, write_person as write_person
from ._person_model import PersonModel as PersonModel, Sighting as Sighting
from ._read import best_person as best_person, read_people as read_people, read_video as read_video
from ._region import Region as Region
from ._runner import require_runner as require_runner
from ._unfinished import SeenSoFar as SeenSoFar, read_seen as read_seen, write_seen as write_seen
from ._weights import Weights as Weights, get_weights as get_weights
