"""python examples/gym_snap.py tiny

Scores the guess and the true motion of a few queries in an environment of gymnasium (extra `gym`).
"""

from __future__ import annotations

from pathlib import Path

import tyro

from kit1000.gym import AssemblyEnv, motion_vector


def main(data: tyro.conf.Positional[Path] = Path("tiny"), episodes: int = 3) -> None:
    """Run episodes.

    Args:
        data: the dataset folder.
        episodes: number of queries.
    """
    env = AssemblyEnv(data, "snap", split="val")  # as gymnasium.make("kit1000.gym:kit1000/Snap-v0", data=data, ...)
    for seed in range(episodes):
        observation, _ = env.reset(seed=seed)
        truth = env.dataset.truth_of(env.query)
        for name, action in (("guess", observation["guess"]), ("truth", motion_vector(truth.goal_drawn))):
            _, reward, _, _, info = env.step(action)
            print(f"{env.query.id} {name}: reward {reward:.0f}, {1e3 * info['position']:.1f} mm off")


if __name__ == "__main__":
    tyro.cli(main)
