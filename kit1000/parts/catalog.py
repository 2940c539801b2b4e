"""All part families by name, and how often each is drawn."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from kit1000.parts.families.block import Block
from kit1000.parts.families.bracket import Bracket
from kit1000.parts.families.bushing import Bushing
from kit1000.parts.families.cam import Cam
from kit1000.parts.families.channel import Channel
from kit1000.parts.families.clevis import Clevis
from kit1000.parts.families.clip import Clip
from kit1000.parts.families.connector import Connector
from kit1000.parts.families.cover import Cover
from kit1000.parts.families.crank import Crank
from kit1000.parts.families.dovetail import Dovetail
from kit1000.parts.families.elbow import Elbow
from kit1000.parts.families.flange import Flange
from kit1000.parts.families.foot import Foot
from kit1000.parts.families.frame import Frame
from kit1000.parts.families.frame_corner import FrameCorner
from kit1000.parts.families.gear import Gear
from kit1000.parts.families.grille import Grille
from kit1000.parts.families.heat_sink import HeatSink
from kit1000.parts.families.hinge import Hinge
from kit1000.parts.families.hook import Hook
from kit1000.parts.families.housing import Housing
from kit1000.parts.families.knob import Knob
from kit1000.parts.families.lever import Lever
from kit1000.parts.families.link import Link
from kit1000.parts.families.motor_mount import MotorMount
from kit1000.parts.families.mounting_plate import MountingPlate
from kit1000.parts.families.pillow_block import PillowBlock
from kit1000.parts.families.pulley import Pulley
from kit1000.parts.families.ratchet import Ratchet
from kit1000.parts.families.servo_horn import ServoHorn
from kit1000.parts.families.stepped_shaft import SteppedShaft
from kit1000.parts.families.tee import Tee
from kit1000.parts.families.wedge import Wedge
from kit1000.parts.families.yoke import Yoke
from kit1000.parts.family import Family
from kit1000.rng import stream

FAMILIES: dict[str, type[Family]] = {
    "block": Block,
    "bracket": Bracket,
    "bushing": Bushing,
    "cam": Cam,
    "channel": Channel,
    "clevis": Clevis,
    "clip": Clip,
    "connector": Connector,
    "cover": Cover,
    "crank": Crank,
    "dovetail": Dovetail,
    "elbow": Elbow,
    "flange": Flange,
    "foot": Foot,
    "frame": Frame,
    "frame_corner": FrameCorner,
    "gear": Gear,
    "grille": Grille,
    "heat_sink": HeatSink,
    "hinge": Hinge,
    "hook": Hook,
    "housing": Housing,
    "knob": Knob,
    "lever": Lever,
    "link": Link,
    "motor_mount": MotorMount,
    "mounting_plate": MountingPlate,
    "pillow_block": PillowBlock,
    "pulley": Pulley,
    "ratchet": Ratchet,
    "servo_horn": ServoHorn,
    "stepped_shaft": SteppedShaft,
    "tee": Tee,
    "wedge": Wedge,
    "yoke": Yoke,
}
"""Family name -> its class. A new family is one file beside this one, one line here and one in `WEIGHTS`."""

WEIGHTS: dict[str, float] = {
    "block": 4.5,
    "bracket": 1.0,
    "bushing": 1.5,
    "cam": 0.8,
    "channel": 1.0,
    "clevis": 0.7,
    "clip": 1.0,
    "connector": 1.0,
    "cover": 0.5,
    "crank": 1.0,
    "dovetail": 0.8,
    "elbow": 1.0,
    "flange": 1.5,
    "foot": 0.5,
    "frame": 3.5,
    "frame_corner": 0.8,
    "gear": 1.0,
    "grille": 1.5,
    "heat_sink": 2.0,
    "hinge": 1.0,
    "hook": 1.5,
    "housing": 0.5,
    "knob": 1.0,
    "lever": 2.5,
    "link": 3.0,
    "motor_mount": 1.5,
    "mounting_plate": 1.5,
    "pillow_block": 0.6,
    "pulley": 2.5,
    "ratchet": 0.7,
    "servo_horn": 0.6,
    "stepped_shaft": 1.5,
    "tee": 1.0,
    "wedge": 2.5,
    "yoke": 0.6,
}
"""How often each family is drawn, relative to the others."""


def choose_family(root: int, *key: int | str, weights: Mapping[str, float] = MappingProxyType(WEIGHTS)) -> str:
    """The family of the part that `key` names, drawn by weight from the root seed.

    A race: each family gets an exponential finishing time of its own stream, divided by its weight, and the first wins.
    So a family that is added later changes only the parts that it wins (Efraimidis and Spirakis 2006).
    """
    finish = {name: stream(root, *key, "family", name).exponential() / weight for name, weight in weights.items()}
    return min(finish, key=finish.__getitem__)
