"""Run folder: all files of a run, written so that a kill at any moment is safe.

    config.yaml      the complete configuration, with all defaults and named files
    meta.json        versions, seed, host, devices, times
    metrics.csv      a row per generation and run
    start.npz        initial genomes, if not random
    checkpoints/     last two generations, with the champions of all runs (for `resume`)
    champion.npz     genome, fitness, terms and motion of the best individual of all runs
    candidates.csv   with noise: results of the candidates for the champion
    lineage.npz      earlier champions, at most 32 of each run, see `evo_cpg.training.lineage`
    family.bin       all individuals of evolving plans, see `evo_cpg.training.family`
    refine.csv       gain of every round of `refine`
    champion_before.npz, config_before.yaml: initial state of `refine`
    videos/, plots/  output of `render` and `plot`
    analysis.html    page of the run, by `analyse`
    probe.csv, sensitivity.csv, audit.json and their pictures: output of these commands
    .lock            name of the process that writes here, see `evo_cpg.locks`

Files are written under another name and then moved, which is atomic. Files that belong together
are first written to a folder of their own. When all are complete, this folder is renamed, and its
files are moved into the run folder. If a kill interrupts the moves, the next process that opens the
run moves the remaining files. Checkpoints are plain ``.npz`` files, not orbax checkpoints: a dozen
arrays are written in 5 ms, and they open in NumPy without JAX.
"""

import contextlib
import csv
import hashlib
import io
import json
import math
import os
import re
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
from jaxtyping import Float

from evo_cpg import locks
from evo_cpg.errors import UserError
from evo_cpg.files import cannot_write, read_json, write_text, write_whole
from evo_cpg.simulation.recording import Recording
from evo_cpg.training.checkpoint import (
    DAMAGED,
    SCALE_PREFIX,
    TERM_PREFIX,
    Champion,
    Checkpoint,
    below,
    champion_arrays,
    checkpoint_arrays,
    history_columns,
    read_arrays,
    read_champion,
    read_checkpoint,
)

CANDIDATES_FILE = "candidates.csv"
"""File with the results of the candidates for champion (see `evo_cpg.training.reevaluation`)."""

_KEPT_CHECKPOINTS = 2
# Folder in which files that belong together are written, and its later name. Under the later name
# the files are complete and wait to be moved into the run folder.
_GATHERED, _DECIDED = ".gathered", ".decided"
_RECORDING_PREFIX = "recording."
# Keys of meta.json that code relies on, with their types.
_META = {"devices": int, "config": str, "replaced": list, "fingerprint": dict}
_MOST_DEVICES = 4096
# Numbers of each champion of a lineage.
_OF_ALL = ("fitness", "generation", "run", "index")
_DIGESTS = ("config_sha256", "genes_sha256", "outcome_sha256")


class RunFolderError(UserError):
    """Error of a run folder that cannot be used. The message names reason and remedy."""


class RunFolder:
    """Run folder on disk.

    Attributes:
        path: path of the folder.
        config: path of config.yaml, the complete configuration.
        metrics: path of metrics.csv, the table of generations.
        champion: path of champion.npz, the best individual.
        lineage: path of lineage.npz, the earlier champions.
        start: path of start.npz, the initial genomes.
        meta: path of meta.json, with versions, host and times.
    """

    def __init__(self, path: Path | str):
        self.path = Path(path)
        self.config = self.path / "config.yaml"
        self.metrics = self.path / "metrics.csv"
        self.champion = self.path / "champion.npz"
        self.lineage = self.path / "lineage.npz"
        self.start = self.path / "start.npz"
        self.meta = self.path / "meta.json"
        # Last written rows of metrics.csv, and their text.
        self._table: tuple[list[dict[str, float]], str] = [], ""
        # Rows of the last written checkpoint, and their columns.
        self._columns: tuple[list[dict[str, float]], dict[str, np.ndarray]] = [], {}

    @contextlib.contextmanager
    def locked(self, new: bool = False) -> Iterator[None]:
        """Keep other processes from writing in this folder while the ``with`` block lasts.

        Args:
            new: whether the run begins here, so that the folder may be missing.

        Raises:
            LockedError: another process writes here.
            OutputError: the folder cannot be written.
            RunFolderError: there is no run, and ``new`` is False.
        """
        if not new:
            self._require_config()
        with locks.locked(self.path, make=new):
            yield

    def create(
        self,
        config_text: str,
        meta: Mapping[str, Any],
        start: Float[np.ndarray, "g all"] | None = None,
    ) -> None:
        """Start a run in a folder that holds none yet.

        Args:
            config_text: the complete configuration, as YAML.
            meta: contents of meta.json.
            start: initial genomes, or None for random ones.

        Raises:
            OutputError: the folder cannot be written.
            RunFolderError: the folder holds a run or other files.
        """
        try:
            if self.path.exists() and not self.path.is_dir():
                raise RunFolderError(f"{self.path} is a file. Choose another --out")
            if self.config.exists():
                done = f" ({self.newest} generations are done)" if self.newest else ""
                advice = f"Continue with `evo-cpg resume {self.path}`{done} or choose another --out"
                if self.read_meta().get("replaced"):
                    advice = (
                        "It began in Python. To continue, start a new run from its genomes in "
                        "another folder: `evo.train(..., start=...)`"
                    )
                raise RunFolderError(f"{self.path} already holds a run. {advice}")
            leftover = (
                locks.FILE,
                f".{self.config.name}.",
                f".{self.start.name}.",
                self.start.name,
            )
            if self.path.is_dir() and any(
                not other.name.startswith(leftover) for other in self.path.iterdir()
            ):
                raise RunFolderError(
                    f"{self.path} is not empty and holds no run. Choose another --out"
                )
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise cannot_write(self.path, error) from None
        self.start.unlink(missing_ok=True)
        if start is not None:
            write_whole(self.start, lambda file: np.savez(file, genes=start))
        # Write the config after the genomes: a folder with a config can be resumed.
        self.reopen(config_text)
        self.update_meta(**meta)

    def require(self) -> None:
        """Check that there is a run here, and finish interrupted writes.

        Raises:
            RunFolderError: there is no run.
        """
        if locks.holds(self.path):
            self._move_decided()
        elif (self.path / _DECIDED).is_dir():
            # If another process has the lock, that process moves the files.
            with contextlib.suppress(locks.LockedError), locks.locked(self.path):
                self._move_decided()
        self._require_config()

    def _require_config(self) -> None:
        if not self.config.is_file():
            raise RunFolderError(f"{self.path} is not a run folder (it has no config.yaml)")

    def reopen(self, config_text: str) -> None:
        """Write config.yaml and make missing folders.

        Raises:
            OutputError: the folder cannot be written.
        """
        write_text(self.config, config_text)
        try:
            for part in ("checkpoints", "videos", "plots"):
                (self.path / part).mkdir(exist_ok=True)
        except OSError as error:
            raise cannot_write(self.path, error) from None

    def load_start(self) -> Float[np.ndarray, "g all"] | None:
        """Return the initial genomes of the run, or None if random.

        Raises:
            RunFolderError: the file is missing, cannot be read, or holds something else.
        """
        if not self.start.is_file():
            if given := self.read_meta().get("start"):
                raise RunFolderError(
                    f"{self.start} is missing. It held the run's initial genomes ({given}). Put "
                    "it back or start a new run"
                )
            return None
        try:
            genes = read_arrays(self.start)["genes"]
            if genes.ndim != 2 or not np.isfinite(genes).all():
                raise ValueError("it holds no genomes")
        except DAMAGED as error:
            raise RunFolderError(f"{self.start} is damaged ({error}). Start a new run") from None
        return genes

    def read_meta(self) -> dict[str, Any]:
        """Return the contents of meta.json, or an empty dictionary if it is missing or broken."""
        try:
            meta = read_json(self.meta, dict[str, Any])
        except (OSError, ValueError):
            return {}
        sound = all(isinstance(meta[key], kind) for key, kind in _META.items() if key in meta)
        # A replay has a chunk as wide as in training. A false number of devices could make it fill
        # the machine's memory.
        return meta if sound and 0 < meta.get("devices", 1) <= _MOST_DEVICES else {}

    def update_meta(self, **values: Any) -> None:
        """Add or replace values in meta.json."""
        self.write_json(self.meta.name, self.read_meta() | values)

    def write_json(self, name: str, values: Mapping[str, Any]) -> None:
        """Write a .json file of the folder. Numbers that are not finite become null."""
        text = json.dumps(_finite(values), indent=2, allow_nan=False)
        write_text(self.path / name, text)

    def save(self, checkpoint: Checkpoint) -> None:
        """Write a checkpoint, metrics.csv and the champion if it is new."""
        champion = checkpoint.champion
        if champion is not None and (
            not self.champion.exists()
            or checkpoint.chosen
            or champion.generation == checkpoint.generation - 1
        ):
            self.save_champion(champion)
        rows, columns = self._columns
        if checkpoint.history[: len(rows)] != rows:
            columns = {}
        columns = history_columns(checkpoint.history, columns)
        self._columns = checkpoint.history, columns
        arrays = checkpoint_arrays(checkpoint, columns)
        place = self.path / "checkpoints" / f"generation_{checkpoint.generation:06d}.npz"
        write_whole(place, lambda file: np.savez(file, **arrays))
        self.write_metrics(checkpoint.history)
        for _, old in self._checkpoints()[:-_KEPT_CHECKPOINTS]:
            old.unlink(missing_ok=True)

    def load(self, most: int | None = None) -> Checkpoint | None:
        """Return the newest readable checkpoint, or None before the first generation is done.

        Args:
            most: largest number of finished generations, or None for any number. There may be no
                such checkpoint.

        Raises:
            RunFolderError: there are checkpoints, but none that can be read.
        """
        wrong: list[str] = []
        for done, path in reversed(self._checkpoints()):
            if most is not None and done > most:
                continue
            try:
                return read_checkpoint(read_arrays(path))
            except FileNotFoundError:
                # The training process deleted this checkpoint meanwhile.
                continue
            except DAMAGED as error:
                reason = getattr(error, "strerror", None) or error
                wrong.append(f"{path.name}: {reason}")
        if wrong:
            # Do not restart at generation 0: the finished generations may be recoverable.
            raise RunFolderError(
                f"{self.path / 'checkpoints'}: no checkpoint can be read ({', '.join(wrong)}). "
                "Make them readable, put copies back, or delete them to restart the run"
            )
        return None

    def save_champion(self, champion: Champion, recording: Recording | None = None) -> None:
        """Write champion.npz, with the motion if recorded."""
        write_whole(self.champion, _champion_writer(champion, self.config_digest(), recording))

    def keep_before(self, champion: Champion, recording: Recording | None = None) -> None:
        """Write champion_before.npz, and copy config.yaml to config_before.yaml."""
        before = self.champion.with_stem(f"{self.champion.stem}_before")
        write_whole(before, _champion_writer(champion, self.config_digest(), recording))
        config = self.config.read_bytes()
        before = self.config.with_stem(f"{self.config.stem}_before")
        write_whole(before, lambda file: file.write(config))

    def replace_champion(self, champion: Champion, config_text: str) -> None:
        """Replace the champion of a run by a refined individual, with its configuration.

        It also takes the last place in the run's population, so that evolution can use it.
        """
        config = config_text.encode()
        writes: dict[Path, Callable[[IO[bytes]], object]] = {
            self.config: lambda file: file.write(config)
        }
        checkpoint, best = self.load(), champion
        if checkpoint is not None:
            records, chosen = list(checkpoint.records), list(checkpoint.chosen)
            for champions in (records, chosen):
                if champions:
                    champions[champion.run] = champion
            genes = checkpoint.genes.copy()
            population = genes.shape[1] // len(records)
            genes[:, (champion.run + 1) * population - 1] = champion.genes
            checkpoint = checkpoint._replace(
                records=tuple(records), chosen=tuple(chosen), genes=genes
            )
            best = checkpoint.champion or champion
            arrays = checkpoint_arrays(checkpoint)
            place = self.path / "checkpoints" / f"generation_{checkpoint.generation:06d}.npz"
            writes[place] = lambda file: np.savez(file, **arrays)
        writes[self.champion] = _champion_writer(best, hashlib.sha256(config).hexdigest())
        # Write all files or none, even after a kill.
        gathered = self.path / _GATHERED
        try:
            shutil.rmtree(gathered, ignore_errors=True)
            for path, write in writes.items():
                place = gathered / path.relative_to(self.path)
                place.parent.mkdir(parents=True, exist_ok=True)
                write_whole(place, write)
            os.replace(gathered, self.path / _DECIDED)
        except OSError as error:
            raise cannot_write(self.path, error) from None
        self._move_decided()

    def save_lineage(self, lineage: Sequence[Champion]) -> None:
        """Write lineage.npz with at least one champion."""
        arrays: dict[str, Any] = {"genes": np.stack([each.genes for each in lineage])}
        arrays |= {name: np.array([getattr(each, name) for each in lineage]) for name in _OF_ALL}
        for prefix, rows in (
            (TERM_PREFIX, [each.terms for each in lineage]),
            (SCALE_PREFIX, [each.scales for each in lineage]),
        ):
            # Champions of one run may have different terms: the configuration's measures may have
            # changed.
            names = dict.fromkeys(name for one in rows for name in one)
            arrays |= {
                prefix + name: np.array([one.get(name, math.nan) for one in rows]) for name in names
            }
        write_whole(self.lineage, lambda file: np.savez(file, **arrays))

    def load_lineage(self) -> list[Champion]:
        """Return the earlier champions, run by run, in the order of generations.

        Raises:
            RunFolderError: there are none, or the file cannot be read.
        """
        if not self.lineage.is_file():
            raise RunFolderError(f"{self.path} has no lineage.npz: no champion was found yet")
        try:
            arrays = read_arrays(self.lineage)
            genes = arrays["genes"]
            columns = {name: arrays[name].tolist() for name in _OF_ALL}
            terms, scales = (
                {name: values.tolist() for name, values in below(arrays, prefix).items()}
                for prefix in (TERM_PREFIX, SCALE_PREFIX)
            )
            return [
                Champion(
                    genes[i],
                    columns["fitness"][i],
                    columns["generation"][i],
                    {name: values[i] for name, values in terms.items()},
                    {name: values[i] for name, values in scales.items()},
                    columns["run"][i],
                    columns["index"][i],
                )
                for i in range(len(genes))
            ]
        except DAMAGED as error:
            raise RunFolderError(
                f"{self.lineage} is damaged ({error}). The run can continue, but its earlier "
                "champions are lost"
            ) from None

    def load_champion(self) -> tuple[Champion, Recording | None, dict[str, str]]:
        """Return the champion, its motion if recorded, and the digests written with it.

        Raises:
            RunFolderError: there is no champion yet, or the file cannot be read.
        """
        if not self.champion.is_file():
            raise RunFolderError(f"{self.path} has no champion yet. Train it first")
        try:
            arrays = read_arrays(self.champion)
            champion = read_champion(arrays)
            digests = {name: str(arrays[name]) for name in _DIGESTS}
            if _RECORDING_PREFIX + "time" not in arrays:
                return champion, None, digests
            fields: dict[str, Any] = {
                name: arrays[_RECORDING_PREFIX + name] for name in Recording._fields
            }
            fields["dof_names"] = tuple(str(name) for name in fields["dof_names"])
            return champion, Recording(**fields), digests
        except DAMAGED as error:
            raise RunFolderError(
                f"{self.champion} is damaged ({error}). `evo-cpg resume {self.path}` writes it "
                "again"
            ) from None

    def history(self) -> dict[str, np.ndarray]:
        """Return the columns of metrics.csv, from the newest checkpoint.

        Raises:
            RunFolderError: no generation is done yet.
        """
        checkpoint = self.load()
        if checkpoint is None or not checkpoint.history:
            raise RunFolderError(f"{self.path} has no finished generation yet")
        return history_columns(checkpoint.history)

    def config_digest(self) -> str:
        """Return the SHA-256 of config.yaml."""
        return hashlib.sha256(self.config.read_bytes()).hexdigest()

    def _move_decided(self) -> None:
        decided = self.path / _DECIDED
        try:
            for place in sorted(decided.rglob("*")):
                if place.is_file():
                    os.replace(place, self.path / place.relative_to(decided))
            if decided.is_dir():
                shutil.rmtree(decided)
        except OSError as error:
            raise cannot_write(self.path, error) from None

    def _checkpoints(self) -> list[tuple[int, Path]]:
        """Return the checkpoints with their generations, the newest last."""
        found = (self.path / "checkpoints").glob("generation_*.npz")
        named = ((re.fullmatch(r"generation_(\d{6,})\.npz", path.name), path) for path in found)
        # Numbers sort beyond six digits.
        return sorted((int(name[1]), path) for name, path in named if name)

    @property
    def newest(self) -> int:
        """Number of finished generations, from the newest checkpoint's name. 0 without checkpoints.

        The file is not read, so this is quick.
        """
        found = self._checkpoints()
        return found[-1][0] if found else 0

    def write_metrics(self, history: list[dict[str, float]]) -> None:
        """Write metrics.csv."""
        rows, text = self._table
        # Formatting every row again takes 0.2 s for 3000 generations of 8 runs. Simulating one
        # generation takes twice as long.
        if not rows or history[: len(rows)] != rows:
            rows, text = [], ""
        added = io.StringIO()
        writer = csv.DictWriter(added, fieldnames=list(history[0]), lineterminator="\n")
        if not rows:
            writer.writeheader()
        writer.writerows(history[len(rows) :])
        self._table = history, text + added.getvalue()
        write_text(self.metrics, self._table[1])


def read_checked(path: Path, is_sound: Callable[[Any], bool]) -> Any:
    """Return the contents of a JSON file, or None if there is no file.

    The function ``is_sound`` decides whether the contents are valid.

    Raises:
        RunFolderError: the file is damaged.
    """
    if not path.is_file():
        return None
    try:
        content = read_json(path, Any)
        if not is_sound(content):
            raise ValueError("a value has the wrong type")
    except (AttributeError, KeyError, OSError, TypeError, ValueError) as error:
        raise RunFolderError(f"{path} is damaged ({error})") from None
    return content


def refinements(meta: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the refinements of a run from meta.json: time, command and gain of each."""
    found = meta.get("refined")
    return [one for one in found if isinstance(one, dict)] if isinstance(found, list) else []


def _champion_writer(
    champion: Champion, config_digest: str, recording: Recording | None = None
) -> Callable[[IO[bytes]], object]:
    arrays: dict[str, Any] = champion_arrays(champion)
    arrays |= {"config_sha256": config_digest}
    if recording is not None:
        arrays |= {
            _RECORDING_PREFIX + name: np.asarray(value)
            for name, value in recording._asdict().items()
        }
    return lambda file: np.savez(file, **arrays)


def _finite(value: Any) -> Any:
    """Replace infinity and NaN, which JSON lacks, by None."""
    if isinstance(value, Mapping):
        return {name: _finite(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
