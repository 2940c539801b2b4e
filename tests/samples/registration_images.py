"""Images of the kits of `registration_cases`, and fits about their goals."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from kit1000.camera import Camera, look_at
from kit1000.pose import Pose
from kit1000.registration.search import Candidate
from kit1000.sim.render import render
from kit1000.values import ASSEMBLY_LABEL, LabelledDepth, View
from tests.samples.registration_cases import CASES, WORLD_FROM_KIT, Case
from tests.samples.shapes import seated

CAMERA = Camera(width=320, height=260, fx=900.0, fy=900.0, cx=159.5, cy=129.5)
AWAY = 0.7  # [m]
NOISE = 0.3  # [px]
GAIN = CAMERA.fx * 0.055 / NOISE
MM = 1e3


@cache
def image_of(name: str, polar_deg: float = 35.0, noise_px: float = 0.0, seed: int = 7) -> LabelledDepth:
    """The kit of a case from an angle to its plate's normal, with white noise of its disparities."""
    middle = WORLD_FROM_KIT.xyz
    aside = WORLD_FROM_KIT.rotate((np.sin(np.radians(polar_deg)), 0.0, np.cos(np.radians(polar_deg))))
    pose = look_at(middle + AWAY * aside, middle)
    seen = render(CAMERA, pose, [(seated(CASES[name]()).kit().mesh, WORLD_FROM_KIT)], 1)
    gain = CAMERA.fx * 0.055
    drawn = noise_px * np.random.default_rng(seed).standard_normal(seen.depth.shape)
    disparity = gain / np.where(seen.depth > 0, seen.depth, np.inf) + drawn
    depth = np.where(seen.depth > 0, gain / np.maximum(disparity, 1.0), 0.0).astype(np.float32)
    return LabelledDepth(View(CAMERA, pose, depth), np.where(seen.body_ids == 1, ASSEMBLY_LABEL, 0).astype(np.uint8))


def moved(known: Case, x_mm: float, y_mm: float, yaw_deg: float) -> Candidate:
    """The goal, moved and rotated in the plate about the part's pivot."""
    at_goal = known.candidate(known.goal)
    pivot = at_goal.plate_from_now.apply(known.pivot)
    yaw = Pose.from_rotvec((0, 0, np.radians(yaw_deg)))
    there = Pose.from_translation(pivot + np.array([x_mm, y_mm, 0.0]) / MM) @ yaw @ Pose.from_translation(-pivot)
    return replace(at_goal, plate_from_now=there @ at_goal.plate_from_now)
