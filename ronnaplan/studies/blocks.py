"""Run a study in blocks, on all cores or a Dask cluster: resumable, and the same for any number of workers."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ronnaplan.documents.files import make_folder, write_atomically
from ronnaplan.errors import InputError
from ronnaplan.scheduler import client_of
from ronnaplan.threads import cores

Record = dict[str, Any]


def run_blocks(
    work: Callable[..., Record],
    blocks: Sequence[tuple[Any, ...]],
    journal: Path,
    settings: Record,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    label: str = "study",
) -> list[Record]:
    """Return ``work(*block)`` for each block, in the order of ``blocks``.

    Finished blocks are kept in ``journal`` (one JSON line each), so that a stopped run goes on where it was.  Each
    block must seed itself, so the result does not depend on the number of workers.  ``scheduler``: address of a Dask
    scheduler; otherwise ``workers`` threads (default: all cores; the kernels release Python's lock).

    Raises `InputError` when the journal belongs to a run with other ``settings`` or the scheduler cannot be reached.
    """
    from tqdm import tqdm

    done = read_journal(journal, settings)
    left = [block for block in blocks if block not in done]
    with open_journal(journal, settings, done) as note, executor(workers, scheduler) as pool:
        futures = {pool.submit(work, *block): block for block in left}
        for future in tqdm(as_completed(futures), total=len(futures), desc=label, unit="block"):
            block = futures[future]
            done[block] = future.result()
            note(block, done[block])
    return [done[block] for block in blocks]


@contextmanager
def executor(workers: int | None, scheduler: str | None) -> Iterator[Executor]:
    """Give the pool that runs the blocks; waiting blocks are dropped when the run is stopped."""
    if scheduler is None:
        pool = ThreadPoolExecutor(workers or cores())
        try:
            yield pool
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
        return
    with client_of(scheduler) as client:
        yield client.get_executor()


def read_journal(journal: Path, settings: Record) -> dict[tuple[Any, ...], Record]:
    """Return the finished blocks of an earlier run; a line torn by a crash is passed over."""
    if not journal.exists():
        return {}
    lines = []
    for line in journal.read_text(encoding="utf-8").splitlines():
        try:
            lines.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    if not lines or lines[0] != settings:
        raise InputError(f"{journal} belongs to a study with other settings; name another folder or remove it")
    return {tuple(line["block"]): line["record"] for line in lines[1:]}


@contextmanager
def open_journal(
    journal: Path, settings: Record, done: dict[tuple[Any, ...], Record]
) -> Iterator[Callable[[tuple[Any, ...], Record], None]]:
    """Rewrite the journal without torn lines and give the function that adds a finished block."""
    whole = [settings, *({"block": block, "record": record} for block, record in done.items())]
    write_whole(journal, "".join(json.dumps(line) + "\n" for line in whole))
    with journal.open("ab", buffering=0) as file:

        def note(block: tuple[Any, ...], record: Record) -> None:
            try:
                file.write(f"{json.dumps({'block': block, 'record': record})}\n".encode())
            except OSError as error:
                raise InputError(
                    f"cannot write {journal}: {error.strerror}; make room, then run it again: it goes on where it was"
                ) from error

        yield note


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file, and the folder it lies in: never half a file. Raises `InputError` where it cannot be written."""
    make_folder(path.parent)
    write_atomically(path, content)
