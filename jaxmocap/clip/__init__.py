"""What is solved over the whole clip once its frames are tracked: smooth motion, feet that stay where they stand."""

from ._contacts import find_contacts as find_contacts
from ._flow_steps import FlowSteps as FlowSteps, flow_steps as flow_steps
from ._solve import ClipPlan as ClipPlan, SolvedClip as SolvedClip, solve_clip as solve_clip
