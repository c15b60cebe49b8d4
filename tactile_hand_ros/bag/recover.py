# SPDX-License-Identifier: Apache-2.0
"""Recovery of bags that were cut off: every message that can still be read, in an intact bag."""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.records import Header

from tactile_hand_ros.bag.bag_file import LIBRARY
from tactile_hand_ros.bag.metadata import FILE_NAME, BagMetadata, FileMetadata
from tactile_hand_ros.bag.metadata_file import check_regular, read_metadata
from tactile_hand_ros.bag.rewrite import (
    RewrittenFile,
    bag_metadata,
    compressed,
    refuse_compressed,
    rewrite,
)
from tactile_hand_ros.bag.salvage import MAGIC, Tally, salvage
from tactile_hand_ros.bag.stream import is_being_written
from tactile_hand_ros.errors import BagError, counted
from tactile_hand_ros.files import replace_text

BROKEN = ".broken"
_SUFFIX = "_recovered"
_COMPRESSED = (".zstd", ".lz4")  # what rosbag2 adds to the names of compressed files


@dataclass(frozen=True)
class RecoveredBag:
    """What came of a recovery.

    Attributes:
        source: The broken bag.
        target: The whole one; the same path if it was repaired in place.
        metadata: Files and topics of the whole bag.
        left: Bytes of messages that were cut off or damaged.
        kept: Where the broken files are now, if they were renamed.
        oversized: What was left because it is too large, empty if nothing.
    """

    source: Path
    target: Path
    metadata: BagMetadata
    left: int
    kept: tuple[Path, ...] = ()
    oversized: str = ""

    @property
    def messages(self) -> int:
        """Number of messages that were recovered."""
        return self.metadata.message_count

    @property
    def sentence(self) -> str:
        """The outcome in words."""
        topics = sum(1 for topic in self.metadata.topics if topic.message_count)
        lost = (
            f"{counted(self.left, 'byte')} could not be used"
            if self.left
            else "nothing was left behind"
        )
        if self.oversized:
            lost += f" ({self.oversized})"
        where = (
            f"the broken file is kept as {', '.join(map(str, self.kept))}"
            if self.kept
            else f"{self.source} was not touched"
        )
        return (
            f"recovered {counted(self.messages, 'message')} on {counted(topics, 'topic')} to "
            f"{self.target}; {lost}; "
            f"{where}"
        )


def recover(
    bag: Path | str, out: Path | str | None = None, *, in_place: bool = False
) -> RecoveredBag:
    """Make an intact bag of one that was cut off or damaged, by any recorder.

    Args:
        bag: Bag folder, folder of a run with ``bag/`` in it, or ``.mcap`` file.
        out: Folder to create; by default beside the bag, with ``_recovered`` after its name.
        in_place: Repair the bag's folder itself; broken files are kept there as ``*.broken``.

    Raises:
        BagError: If there is no MCAP bag, it is still being recorded, the output exists, or the
            disk refuses the data.
    """
    source = find_bag(Path(bag))
    if in_place:
        if not source.is_dir():
            raise BagError(f"{source} is a file, expected a folder to repair; give --out instead.")
        return repair(source)
    with _sentences(source):
        files = _files_of(source)
        plain = source if source.is_dir() else source.with_suffix("")
        if plain.name in ("", ".."):
            plain = plain.resolve()
        target = Path(out) if out is not None else plain.with_name(plain.resolve().name + _SUFFIX)
        _create(target)
        try:
            name = target.resolve().name
            names = [target / f"{name}_{number}.mcap" for number in range(len(files))]
            return _finish(source, target, [rewrite(*pair) for pair in zip(files, names)])
        except BaseException:  # half a bag would only be in the way of the next attempt
            shutil.rmtree(target, ignore_errors=True)
            raise


@contextlib.contextmanager
def _sentences(bag: Path) -> Iterator[None]:
    """Report what the system refuses as an error of the user."""
    try:
        yield
    except OSError as error:
        raise BagError(
            f"The bag {bag} could not be read or written ({error.strerror or error}: "
            f"{error.filename or bag}); check disk and mode, free some space."
        ) from error


def is_whole(bag: Path) -> bool:
    """Return whether nothing is missing in a bag: every file is read to find that out.

    Raises:
        BagError: If there is no MCAP bag, it is still being recorded, or cannot be read.
    """
    with _sentences(bag):
        files = _files_of(bag)
        told = _old_metadata(bag)
        if bag.is_dir() and not _names_all(told, files):
            return False
        if not all(_has_end(file) for file in files):
            return False
        tallies = [_walk(file) for file in files]
    count = sum(tally.messages for tally in tallies)
    return all(tally.intact for tally in tallies) and told.get("message_count", count) == count


def _walk(file: Path) -> Tally:
    tally = Tally()
    for _ in salvage(file, tally):
        pass
    return tally


def _old_metadata(bag: Path) -> dict[str, Any]:
    """Return what ``metadata.yaml`` says, nothing if it is missing or makes no sense."""
    try:
        return read_metadata(bag)
    except BagError:
        return {}


def _names_all(told: Mapping[str, Any], files: Sequence[Path]) -> bool:
    named = told.get("relative_file_paths")
    names = {Path(str(path)).name for path in named} if isinstance(named, list) else set()
    return names == {file.name for file in files}


def repair(folder: Path) -> RecoveredBag:
    """Repair the files in a bag folder, and write its metadata again.

    At every moment there is a file under each name, the broken or the whole one.

    Raises:
        BagError: As `recover`.
    """
    copies, kept = [], []
    with _sentences(folder):
        for file in _files_of(folder):
            draft = file.with_name(f".{file.name}")
            draft.unlink(missing_ok=True)  # of a repair that was interrupted
            before = _state(file)
            try:
                copy = rewrite(file, draft)
                if _state(file) != before:
                    raise BagError(
                        f"The file {file} has changed meanwhile, so somebody still writes it; "
                        "stop the recorder and try again."
                    )
                if not copy.tally.intact:
                    kept.append(_keep(file))
                    draft.replace(file)
            finally:
                draft.unlink(missing_ok=True)
            copies.append(copy)
        if (folder / FILE_NAME).exists():
            kept.append(_keep(folder / FILE_NAME))
        return _finish(folder, folder, copies, tuple(kept))


def _state(file: Path) -> tuple[int, int]:
    return file.stat().st_size, file.stat().st_mtime_ns


def continue_bag(folder: Path) -> RecoveredBag | None:
    """Repair a broken bag that a recorder of this package left, so that it can be continued.

    Args:
        folder: What is to be recorded to.

    Returns:
        None if there is nothing to continue: no folder, or one that holds something else.

    Raises:
        BagError: If the bag is still being recorded, or was recorded by other software.
    """
    if not folder.is_dir() or (folder / FILE_NAME).exists() or not any(folder.glob("*.mcap")):
        return None
    for file in _files_of(folder):
        header = next(iter(salvage(file, Tally())), None)
        if isinstance(header, Header) and header.library != LIBRARY:
            raise BagError(
                f"The output {folder} holds a broken bag of '{header.library}', which is not "
                f"continued; run `tactile-hand recover {folder}` and record to another folder."
            )
    return repair(folder)


def find_bag(path: Path) -> Path:
    """Return the bag that a path means: itself, or ``bag/`` in the folder of a run.

    Raises:
        BagError: If it does not exist.
    """
    if not path.exists():
        raise BagError(f"The bag {path} does not exist; check the path.")
    return path / "bag" if (path / "bag").is_dir() else path


def _files_of(bag: Path) -> list[Path]:
    files = [bag] if bag.is_file() else sorted(bag.glob("*.mcap"), key=_natural)
    files = [file for file in files if not file.name.startswith(".")]
    others = [bag] if bag.is_file() else bag.glob("*.mcap.*")
    if any(file.suffix in _COMPRESSED for file in others):
        raise compressed(bag)
    if not files:
        raise BagError(f"The folder {bag} holds no .mcap file; only MCAP bags can be recovered.")
    refuse_compressed(bag, _old_metadata(bag))
    for file in files:
        check_regular(file)
        if is_being_written(file):
            raise BagError(
                f"The bag {bag} is being recorded at this moment; stop the recorder, which "
                "finishes it."
            )
    return files


def _natural(path: Path) -> list[tuple[int, str]]:
    parts = re.findall(r"\d+|\D+", path.name)
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts]


def _has_end(file: Path) -> bool:
    with file.open("rb") as stream:
        size = file.stat().st_size
        stream.seek(max(0, size - len(MAGIC)))
        return size > 2 * len(MAGIC) and stream.read() == MAGIC


def _finish(
    source: Path, target: Path, copies: Sequence[RewrittenFile], kept: tuple[Path, ...] = ()
) -> RecoveredBag:
    """Write the metadata of all files."""
    left = sum(copy.tally.left for copy in copies)
    metadata = bag_metadata(
        [copy.file if copy.file.path[0] != "." else _renamed(copy.file) for copy in copies],
        [topic for copy in copies for topic in copy.topics],
        [copy.told for copy in copies],
        {"recovered_bytes_left": str(left)},
    )
    replace_text(target / FILE_NAME, metadata.file_text())
    oversized = (copy.tally.oversized for copy in copies)
    return RecoveredBag(source, target, metadata, left, kept, next(filter(None, oversized), ""))


def _renamed(file: FileMetadata) -> FileMetadata:
    return FileMetadata(file.path[1:], file.start, file.duration, file.message_count)


def _keep(file: Path) -> Path:
    """Give a broken file a second name that is not taken, by whomever and whenever."""
    for number in itertools.count():
        kept = file.with_name(f"{file.name}{BROKEN}{number or ''}")
        with contextlib.suppress(FileExistsError):
            _link_or_copy(file, kept)
            break
    return kept


def _link_or_copy(file: Path, kept: Path) -> None:
    """Give a file a second name.

    Raises:
        FileExistsError: If the name is taken; what has it is left as it is.
    """
    try:
        os.link(file, kept)
    except OSError:  # the name is taken, or this is a file system without links
        with file.open("rb") as source, kept.open("xb") as target:
            try:
                shutil.copyfileobj(source, target)
            except OSError:
                kept.unlink(missing_ok=True)
                raise
        shutil.copystat(file, kept)


def _create(folder: Path) -> None:
    try:
        folder.mkdir(parents=True)
    except FileExistsError:
        raise BagError(
            f"The output {folder} exists already, expected a new folder; remove it or choose "
            "another one with --out."
        ) from None
    except OSError as error:
        raise BagError(
            f"The output {folder} cannot be created: {error.strerror}; choose another one with "
            "--out."
        ) from None
