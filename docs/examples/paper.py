"""Repeats the experiments of the paper on simulated recordings, and writes docs/paper.md with its pictures.

    python docs/examples/paper.py

Equal options give equal figures on one machine. ``--recordings`` says of how many of each contact the first
experiment takes the median, ``--slsqp-every`` on how many windows of the second one SLSQP runs.
"""

import argparse
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import Final

from paper_document import document
from paper_figures import draw_geometry, draw_sequence
from paper_replication import MOVED, NOISES, replicate_contact, replicate_sequence

DOCS: Final = Path(__file__).resolve().parents[1]
SEED: Final = 1
"""Of the second experiment; its recording with white noise is recordings/paper_experiment.mcap."""


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--recordings", type=int, default=8, metavar="N", help="default: %(default)s")
    parser.add_argument("--slsqp-every", type=int, default=20, metavar="N", help="default: %(default)s")
    parser.add_argument("--processes", type=int, default=os.cpu_count(), metavar="N")
    parser.add_argument("--docs", type=Path, default=DOCS, help="folder to write to, default: %(default)s")
    args = parser.parse_args(argv)
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ[f"{library}_NUM_THREADS"] = "1"  # spawned, so that the workers' numpy sees it
    runs = list(product(MOVED, NOISES, range(args.recordings)))
    with ProcessPoolExecutor(args.processes, mp_context=get_context("spawn")) as pool:
        sequences = pool.map(
            partial(replicate_sequence, seed=SEED, slsqp_every=args.slsqp_every), NOISES, chunksize=1
        )
        contacts = list(pool.map(replicate_contact, *zip(*runs, strict=True)))
        by_noise = {entry.noise: entry for entry in sequences}
    images = args.docs / "images"
    images.mkdir(parents=True, exist_ok=True)
    first = [next(entry for entry in contacts if entry.contact is contact) for contact in MOVED]
    draw_geometry(first).savefig(images / "paper_geometry.png", dpi=100)
    for noise, entry in by_noise.items():
        draw_sequence(entry).savefig(images / f"paper_sequence_{noise}.png", dpi=100)
    (args.docs / "paper.md").write_text(document(contacts, by_noise), encoding="utf-8")


if __name__ == "__main__":
    main()
