"""What trainings on rounds of drives have in common: their folder, processes and regression."""

from __future__ import annotations

import json
import multiprocessing
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from carosac_toolkit.base.arrays import Array
from carosac_toolkit.base.errors import InvalidField
from carosac_toolkit.base.files import replacing
from learned.policy_network import Layers

SETTINGS_FILE, TABLE_FILE, NETWORK_FILE = "settings.json", "rounds.csv", "network.onnx"
HELD_OUT_EVERY = 12  # one drive of so many is not trained on
REPORT_EVERY = 500  # updates
CountCallback = Callable[[int, int], None]
ProgressCallback = Callable[[str, int, int], None]
DriveJob = Callable[[int, Path], None]
"""Writes the file of a drive, by its number; another process must be able to import it."""
WriteCallback = Callable[[Path], None]


def begin(folder: Path, record: Mapping[str, Any]) -> None:
    """Write what is trained, or make sure that the folder's training is this one.

    Raises:
        InvalidField: It is another one.
    """
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps(record, indent=1, sort_keys=True) + "\n"
    path = folder / SETTINGS_FILE
    if path.is_file():
        if path.read_text(encoding="utf-8") != text:
            allowed = "a training of this robot, seed and settings, or a new folder"
            raise InvalidField("folder", f"{folder} with another training", allowed)
        return
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def train_rounds(
    folder: Path,
    counts: Sequence[int],
    job: Callable[[int, Path | None], DriveJob],
    fit: Callable[[int, list[Path], CountCallback], tuple[Mapping[str, float], WriteCallback]],
    *,
    columns: Sequence[str],
    drives: str,
    workers: int,
    report: ProgressCallback,
) -> Path:
    """Drive and fit, round after round; return the network of the last one.

    Args:
        folder: Of the training.
        counts: Drives of each round.
        job: Gives what drives in a round, with the network of the one before, None in the first.
        fit: Fits a network to the files of all drives so far; gives its row of the table, beside
            the round and its drives, and what writes it.
        columns: Of the table: the round, the drives so far, and those of `fit`.
        drives: What these are called in reports.
        workers: Processes that drive.
        report: Called with what is being done, how much of it is done, and of how much.
    """
    network: Path | None = None
    paths: list[Path] = []
    for k, count in enumerate(counts):
        name = f"round {k + 1} of {len(counts)}"
        paths += _drive_all(
            job(k, network), range(len(paths), len(paths) + count), folder, workers,
            partial(report, f"{name}: {drives}"),
        )  # fmt: skip
        network = folder / f"round-{k + 1}.onnx"
        if not network.is_file():
            row, write = fit(k, paths, partial(report, f"{name}: updates"))
            _note(folder, k + 1, columns, {"round": k + 1, columns[1]: len(paths)} | dict(row))
            write(network)
    assert network is not None, "there is at least one round"
    with replacing(folder / NETWORK_FILE) as temporary:
        temporary.write_bytes(network.read_bytes())
    return folder / NETWORK_FILE


def _drive_all(
    job: DriveJob,
    numbers: range,
    folder: Path,
    workers: int,
    report: CountCallback,
) -> list[Path]:
    """Do a job for each drive whose file is missing; return all files.

    Args:
        job: Writes the file of a number.
        numbers: Of the drives.
        folder: Of the training.
        workers: Processes.
        report: Called with how many are done, and of how many.
    """
    paths = {k: folder / f"drive-{k:04d}.npz" for k in numbers}
    missing = [k for k, path in paths.items() if not path.is_file()]
    done = len(numbers) - len(missing)
    report(done, len(numbers))
    if workers == 1:
        for k in missing:
            job(k, paths[k])
            done += 1
            report(done, len(numbers))
    elif missing:
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(workers, mp_context=context) as pool:
            for _ in pool.map(job, missing, [paths[k] for k in missing]):
                done += 1
                report(done, len(numbers))
    return list(paths.values())


def median_of_ended(errors: Sequence[float]) -> float:
    """Return the median of the errors of drives that came to their end; NaN: none did."""
    ended = [error for error in errors if np.isfinite(error)]
    return float(np.median(ended)) if ended else float("nan")


def is_held_out(number: int) -> bool:
    """Return whether a drive is not trained on."""
    return number % HELD_OUT_EVERY == HELD_OUT_EVERY - 1


@dataclass(frozen=True, kw_only=True)
class Regression:
    """Numbers of a regression.

    Attributes:
        hidden: Sizes of the hidden layers.
        updates: Of the network.
        batch: Samples of an update.
        rate: Learning rate at the start; it falls to 0 by a cosine.
        decay: Of weights, decoupled from the gradient.
        huber: Of the scale of what is told: larger errors count linearly.
        seed: Of first weights and batches.
    """

    hidden: tuple[int, ...]
    updates: int
    batch: int
    rate: float
    seed: int
    decay: float = 0.0
    huber: float = 0.1


def regress(
    numbers: Array, told: Array, scale: Array, least_spread: Array, settings: Regression,
    report: CountCallback, images: Sequence[tuple[Any, Any, Any]] = (),
) -> Layers:  # fmt: skip
    """Fit a perceptron with silu in between and tanh at its end.

    Args:
        numbers: That it reads, shape (K, m).
        told: That it is to tell, shape (K, out).
        scale: Unit of its errors, shape (out,).
        least_spread: Of each number: what hardly varies is not blown up, shape (m,).
        settings: Settings.
        report: Called with the updates that are done, and of how many.
        images: Order (m,) and sign (m,) of numbers, and order (out,) of what is told, of each way
            to make more samples of one; none leaves all as they are.

    Returns:
        Weights and biases, for numbers as they are.
    """
    import torch

    torch.manual_seed(settings.seed)
    torch.set_num_threads(1)
    mean, spread = _spread(numbers, images)
    spread = np.maximum(spread, least_spread)
    seen = torch.tensor(numbers, dtype=torch.float32)
    goal = torch.tensor(told, dtype=torch.float32)
    unit = torch.tensor(scale, dtype=torch.float32)
    middle, width = (torch.tensor(x, dtype=torch.float32) for x in (mean, spread))
    ways = [
        (torch.tensor(order), torch.tensor(sign, dtype=torch.float32), torch.tensor(out))
        for order, sign, out in images
    ]
    sizes = [seen.shape[1], *settings.hidden, goal.shape[1]]
    modules: list[Any] = []
    for a, b in pairwise(sizes):
        modules += [torch.nn.Linear(a, b), torch.nn.SiLU()]
    network = torch.nn.Sequential(*modules[:-1], torch.nn.Tanh())
    optimiser = torch.optim.AdamW(network.parameters(), settings.rate, weight_decay=settings.decay)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, settings.updates)
    for k in range(settings.updates):
        batch = torch.randint(len(seen), (settings.batch,))
        rows, wanted = seen[batch], goal[batch]
        if ways:
            order, sign, out = ways[k % len(ways)]
            rows, wanted = rows[:, order] * sign, wanted[:, out]
        off = (network((rows - middle) / width) - wanted) / unit
        loss = torch.nn.functional.smooth_l1_loss(off, torch.zeros_like(off), beta=settings.huber)
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        schedule.step()
        if k % REPORT_EVERY == 0:
            report(k, settings.updates)
    return layers_of(network, mean, spread)


def layers_of(network: Any, mean: Array, spread: Array) -> Layers:
    """Return weights and biases for numbers as they are.

    Args:
        network: Of torch, for numbers less their mean, over their spread.
        mean: Of numbers, shape (m,).
        spread: Of numbers, shape (m,).
    """
    linear = [module for module in network if hasattr(module, "weight")]
    layers = [(x.weight.detach().numpy().copy(), x.bias.detach().numpy().copy()) for x in linear]
    first = layers[0][0] / spread.astype(np.float32)
    layers[0] = (first, layers[0][1] - first @ mean.astype(np.float32))
    return layers


def _spread(numbers: Array, images: Sequence[tuple[Any, Any, Any]]) -> tuple[Array, Array]:
    """Return mean and standard deviation (m,) of numbers, and of all their images."""
    mean, square = numbers.mean(axis=0), (numbers**2).mean(axis=0)
    if images:
        square = np.mean([square[order] for order, _, _ in images], axis=0)
        mean = np.mean([sign * mean[order] for order, sign, _ in images], axis=0)
    return mean, np.sqrt(np.maximum(square - mean**2, 0.0))


def _note(folder: Path, number: int, columns: Sequence[str], values: Mapping[str, float]) -> None:
    """Add the row of a round to the table."""
    path = folder / TABLE_FILE
    rows = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
    rows = [",".join(columns), *rows[1:number]]
    rows.append(",".join(f"{values[name]:.6g}" for name in columns))
    with replacing(path) as temporary:
        temporary.write_text("\n".join(rows) + "\n", encoding="utf-8")


def rms(values: Array) -> float:
    """Return the root of the mean square; NaN of nothing."""
    return float(np.sqrt((values**2).mean())) if values.size else float("nan")
