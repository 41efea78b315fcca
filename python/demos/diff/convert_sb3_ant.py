"""Convert an actor that Stable-Baselines3's SAC trained on Ant-v3 into a file of the demos.

The zip file of Stable-Baselines3 contains policy.pth. torch reads this file with weights_only=True,
so that no code of the file runs. Only the network of the actor's mean is converted: 111-256-256-8
with ReLU. The action is tanh(mean).

    python convert_sb3_ant.py sac_ant.zip sac_ant.npz
    python demo_diffsim_ant_walk.py --ant gym --policy sac_ant.npz
"""

from __future__ import annotations

import argparse
import io
import zipfile
from pathlib import Path

import numpy as np
from ant_common import actor_shapes
from demo_common import run

from novaphy import nova
from novaphy.envs import ANTS, asset_hash

MEMBER = "policy.pth"


def read_actor(path: str) -> dict[str, np.ndarray]:
    """Read the six arrays of the actor from an archive.

    Raises:
        ImportError: torch is not installed.
        ValueError: no such archive, parameters that are missing or of another shape.
    """
    import torch

    try:
        with zipfile.ZipFile(path) as archive:
            data = archive.read(MEMBER)
        state = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except (zipfile.BadZipFile, KeyError) as error:
        raise ValueError(f"{path}: expected a zip of SB3 with {MEMBER}: {error}") from None
    except Exception as error:  # torch raises several types for files without tensors
        raise ValueError(f"{path}, {MEMBER}: expected tensors only: {error}") from None
    values = {}
    for name, shape in actor_shapes().items():
        value = state.get(f"actor.{name}") if isinstance(state, dict) else None
        if value is None or tuple(value.shape) != shape:
            got = "nothing" if value is None else tuple(value.shape)
            raise ValueError(f"{path}, actor.{name}: expected {shape}, got {got}")
        values[name] = value.to(torch.float32).numpy()
    return values


def main() -> int:
    """Convert the archive to a file of parameters. Return 0."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("zip", help="what SB3's model.save wrote")
    parser.add_argument("npz", help="the file to write")
    parser.add_argument("--ant", choices=tuple(ANTS), default="gym", help="what it was trained on")
    args = parser.parse_args()
    if not Path(args.zip).is_file():
        parser.error(f"{args.zip}: no such file")
    values = read_actor(args.zip)
    meta = {"ant": args.ant, "asset": asset_hash(args.ant), "source": "Stable-Baselines3 SAC"}
    nova.save_parameters(args.npz, {k: nova.tensor(v) for k, v in values.items()}, meta)
    print(f"{args.npz}: {sum(v.size for v in values.values())} parameters")
    return 0


if __name__ == "__main__":
    run(main)
