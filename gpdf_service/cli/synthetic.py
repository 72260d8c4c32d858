"""`gpdf synthetic NAME --out FILE`: a random place, ray-cast by a scanner, with truth labels and the rays' origins."""

from __future__ import annotations

import argparse
import json
from functools import partial
from pathlib import Path

import numpy as np

from gpdf_service.cli.inputs import check_out
from gpdf_service.cli.work import NAMES, Work
from gpdf_service.errors import ConfigError
from gpdf_service.synthetic.places import PLACES
from gpdf_service.synthetic.scanners import NOISE, SCANNERS, Scan

FORMATS = (".npz", ".ply")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    parser.add_argument("name", choices=list(PLACES), metavar="NAME", help=", ".join(PLACES))
    parser.add_argument("--seed", type=int, default=0, help="another seed, another place of that kind")
    parser.add_argument("--scanner", choices=list(SCANNERS), default="tripod")
    noise = ", ".join(f"{name} {metres}" for name, metres in NOISE.items())
    parser.add_argument("--noise", type=float, help=f"standard deviation along the ray [m]; {noise} when not given")
    parser.add_argument(
        "--thin", type=float, default=0.02, help="keep one point of each voxel of this width [m]; 0: all"
    )
    parser.add_argument("--out", type=Path, required=True, help="the cloud, .npz or .ply")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def run(args: argparse.Namespace) -> int:
    """Make the place, scan it, write the cloud."""
    check_out(args.out)
    if args.out.suffix not in FORMATS:
        raise ConfigError(f"--out {args.out}", "not a kind of file that is written", f"Use {' or '.join(FORMATS)}.")
    for name in ("noise", "thin"):
        value = getattr(args, name)
        if value is not None and not (np.isfinite(value) and value >= 0.0):
            raise ConfigError(f"--{name} {value}", "it must be 0 or more", "Give metres.")
    rng = np.random.default_rng(args.seed)
    with Work("cast", "write", load=None) as work:
        with work.step("cast") as progress:
            place = PLACES[args.name](rng)
            noise = NOISE[args.scanner] if args.noise is None else args.noise
            scan = SCANNERS[args.scanner](place, rng, noise, progress=partial(progress, NAMES["cast"]))
        with work.step("write"):
            scan = scan.thinned(args.thin, rng) if args.thin else scan
            (_write_npz if args.out.suffix == ".npz" else _write_ply)(args.out, scan, place.world.kinds)
    said = {
        "file": str(args.out),
        "place": place.name,
        "points": len(scan.points),
        "ground_points": int(scan.ground.sum()),
        "start": np.round(place.way[0], 3).tolist(),
        "goal": np.round(place.way[-1], 3).tolist(),
    }
    if args.json:
        print(json.dumps(said | {"kinds": list(place.world.kinds)}))
    else:
        print(f"{args.out}: {place.name}, {said['points']} points, {said['ground_points']} of them ground")
        ends = [",".join(map(str, said[end])) for end in ("start", "goal")]  # type: ignore[arg-type]
        print(f"try: gpdf plan {args.out} --start {ends[0]} --goal {ends[1]}")
    return 0


def _write_npz(path: Path, scan: Scan, kinds: tuple[str, ...]) -> None:
    """Points, origins, and two labels: `label` (1 is ground), and `kind`, an index into `kinds`."""
    np.savez_compressed(
        path,
        xyz=scan.points.astype(np.float32),
        origins=scan.origins.astype(np.float32),
        label=scan.ground.astype(np.int32),
        classes=np.array(["other", "ground"]),
        kind=scan.kind.astype(np.int16),
        kinds=np.array(kinds),
    )


def _write_ply(path: Path, scan: Scan, kinds: tuple[str, ...]) -> None:
    """The same as binary PLY; the kinds are told in comments."""
    names = ("x", "y", "z", "origin_x", "origin_y", "origin_z")
    rows = np.zeros(len(scan.points), [*((name, "<f4") for name in names), ("ground", "u1"), ("kind", "u1")])
    for name, column in zip(names, np.hstack([scan.points, scan.origins]).T, strict=True):
        rows[name] = column
    rows["ground"], rows["kind"] = scan.ground, scan.kind
    head = ["ply", "format binary_little_endian 1.0", *(f"comment kind {i} {name}" for i, name in enumerate(kinds))]
    head += [f"element vertex {len(rows)}", *(f"property float {name}" for name in names)]
    head += ["property uchar ground", "property uchar kind", "end_header", ""]
    path.write_bytes("\n".join(head).encode() + rows.tobytes())
