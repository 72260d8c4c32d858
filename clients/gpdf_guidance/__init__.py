"""Guidance of people along a planned trajectory: instructions, speech, haptic cues; and a simulated walker."""

from gpdf_guidance.advice import Advice as Advice
from gpdf_guidance.advice import advise as advise
from gpdf_guidance.announcer import Announcer as Announcer
from gpdf_guidance.catalogue import LANGUAGES as LANGUAGES
from gpdf_guidance.catalogue import phrase as phrase
from gpdf_guidance.guide import Asked as Asked
from gpdf_guidance.guide import Guide as Guide
from gpdf_guidance.guide import Outcome as Outcome
from gpdf_guidance.instruction import Instruction as Instruction
from gpdf_guidance.instruction import Kind as Kind
from gpdf_guidance.instruction import Side as Side
from gpdf_guidance.instruction import Urgency as Urgency
from gpdf_guidance.manner import Detail as Detail
from gpdf_guidance.manner import Manner as Manner
from gpdf_guidance.planner import PERSON as PERSON
from gpdf_guidance.planner import Planned as Planned
from gpdf_guidance.planner import Planner as Planner
from gpdf_guidance.route import Pose as Pose
from gpdf_guidance.route import Route as Route
from gpdf_guidance.route import build_route as build_route
from gpdf_guidance.simulate import Walk as Walk
from gpdf_guidance.simulate import simulate as simulate
from gpdf_guidance.walker import Errors as Errors
from gpdf_guidance.walker import Walker as Walker
