"""Named dataset configurations: number and size of parts, clearance, tilt, tracks."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from kit1000.errors import InputError, did_you_mean
from kit1000.kits.kit import PLATE_WIDTH
from kit1000.queries.tracks import TRACKS
from kit1000.sim.layout import MAX_PART_RADIUS

HELD_OUT = ("cam", "connector", "gear", "hook", "pillow_block", "tee")
"""Families of the test split only; scores on them measure generalisation to unseen families."""

IDEAL_TRACKS = ("snap-tilt", "place", "place-paper")
"""Tracks of the preset `paper`: guesses with a tilt error only, as in the release of the paper, ideal depth."""

REAL_PLATE = 0.119  # [m] of `real-like`: a part of 80 mm, its clearance and a wall at both sides

OUTSIDE_CONFIG = ("name", "seed")
"""Fields of a preset that its `config` omits: the plan states them itself."""

LATER_FIELDS = ("all_upright",)
"""Fields that its `config` omits at their default: they came after datasets whose bytes must stay."""


@dataclass(frozen=True)
class Preset:
    """Configuration of a dataset. Lengths in metres, angles in radians unless the name says otherwise."""

    name: str
    train: int
    """Number of parts, and so of kits, assemblies and scenes, of the training split."""
    val: int
    test: int
    longest: tuple[float, float] = (0.035, 0.05)
    """[m] range of a part's longest side, drawn uniformly."""
    clearance: float = 2.5e-3
    """[m] between part and cavity wall."""
    plate: float = PLATE_WIDTH
    """[m] side of the square plates."""
    kits: tuple[int, int] = (2, 5)
    """Smallest and largest number of kits of an assembly."""
    level_base: bool = False
    """Whether base plates are level, as in the paper."""
    tilt_deg: tuple[float, float] = (10.0, 45.0)
    """Range of a side plate's tilt against its base."""
    brackets_deg: tuple[float, ...] = ()
    """Discrete tilts to draw from instead of the range, for brackets that come in a few angles."""
    tracks: tuple[str, ...] = tuple(TRACKS)
    """Tracks of the queries. Depth images of a sensor are recorded only if a track reads them."""
    curve_scenes: int = 40
    """Number of test scenes whose target has queries at every level of guess error. These queries together reveal the
    goal, so a withheld test split has none."""
    scale: float = 1.0
    """Scale of both halves of the table and of the cameras' distances, for larger parts or plates."""
    frames: int = 1
    """Number of frames of which a depth image of a sensor is the mean."""
    crowded: float = 1 / 3
    """Share of the scenes whose parts are pushed together, among scenes with two parts or more."""
    one_track: bool = False
    """Whether every test scene has the queries of a single track, as a withheld test split needs: several queries about
    one scene could together reveal more than each of them."""
    all_upright: bool = False
    """Whether every part lies on its insertion side, so that a robot that does not turn parts over can take it."""
    mixture: str = "2026"
    """Families and weights of procedural parts, by name in `MIXTURES`."""
    seed: int = 1000

    def count(self, split: str) -> int:
        """Number of parts, and so of assemblies, of a split."""
        return {"train": self.train, "val": self.val, "test": self.test}[split]

    @property
    def max_part_radius(self) -> float:
        """[m] half the diagonal of a part's box, at most."""
        return self.scale * MAX_PART_RADIUS

    def tracks_of(self, split: str) -> tuple[str, ...]:
        """Tracks of the queries of a split."""
        return tuple(track for track in self.tracks if split in TRACKS[track].splits)

    def sensors_of(self, split: str) -> tuple[str, ...]:
        """Sensors whose depth images are recorded in a split."""
        return tuple(dict.fromkeys(("ideal", *(TRACKS[track].sensor for track in self.tracks_of(split)))))

    @property
    def config(self) -> dict[str, Any]:
        """The preset as JSON values, without the fields of OUTSIDE_CONFIG, and of LATER_FIELDS at their default."""
        left_out = {*OUTSIDE_CONFIG, *(key for key in LATER_FIELDS if not getattr(self, key))}
        values = {key: value for key, value in asdict(self).items() if key not in left_out}
        return {key: list(value) if isinstance(value, tuple) else value for key, value in values.items()}


PRESETS = {
    preset.name: preset
    for preset in (
        Preset("tiny", 8, 2, 6),
        Preset("small", 60, 12, 24),
        Preset("kit1000", 1000, 100, 200),
        Preset("paper", 1000, 100, 200, longest=(0.05, 0.05), level_base=True, tracks=IDEAL_TRACKS, crowded=0.0),
        Preset(
            "real-like",
            20,
            10,
            100,
            longest=(0.06, 0.08),
            clearance=10e-3,
            plate=REAL_PLATE,
            kits=(1, 4),
            scale=1.4,
            frames=50,
        ),
        Preset(
            "study",
            2,
            2,
            80,
            longest=(0.045, 0.05),
            kits=(2, 3),
            tilt_deg=(10.0, 30.0),
            brackets_deg=(10.0, 20.0, 30.0),
            curve_scenes=0,
            crowded=0.0,
            all_upright=True,
        ),
        Preset(
            "print",
            0,
            0,
            6,
            kits=(2, 2),
            level_base=True,
            tilt_deg=(10.0, 30.0),
            brackets_deg=(10.0, 20.0, 30.0),
            curve_scenes=0,
            crowded=0.0,
        ),
        Preset("completion", 2000, 100, 100, seed=2000),
    )
}


def preset(name: str) -> Preset:
    """The preset of this name. Raises InputError, which lists the names."""
    if name not in PRESETS:
        raise InputError(f"no preset {name!r}; {did_you_mean(name, PRESETS)}there are {', '.join(PRESETS)}")
    return PRESETS[name]


def preset_of(name: str, config: dict[str, Any]) -> Preset:
    """The preset of a plan, from its name and `config`."""
    values: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in config.items()}
    return Preset(name, **values)
