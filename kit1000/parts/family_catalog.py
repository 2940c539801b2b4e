"""All part families by name."""

from __future__ import annotations

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
"""Family name -> its class. A new family is one file in `families/` and one line here; `mixtures` weighs them."""
