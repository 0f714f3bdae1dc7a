"""The simulation study's tables, in Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ronnaplan.studies.blocks import Record
from ronnaplan.studies.cells import DRAWN, HEADS, Cell, all_heads, calibration_of, protocol_cells
from ronnaplan.studies.judging import PROBABILITY_EDGES


def percent(outcome: Sequence[int]) -> str:
    """Return 'refused / wrong' in percent of all answers."""
    total = sum(outcome)
    return f"{100 * outcome[1] / total:.2f} / {100 * outcome[2] / total:.3f}"


def tables(by_cell: dict[Cell, Record]) -> str:
    """Return the study's tables as Markdown."""
    return "\n".join((outcome_table(by_cell), further_table(by_cell), calibration_table(by_cell)))


def outcome_table(by_cell: dict[Cell, Record]) -> str:
    """Return the table of Fig. 7: unsuccessful / false positive in percent, the three heads together."""
    lines = [
        "| markers | outliers | published, one to one | published, any partner | exact | exact, strict | worst head |",
        "|---|---|---|---|---|---|---|",
    ]
    for f in range(3, 9):
        for o in range(5):
            cell = Cell(0, f, o, expected=f)
            record = all_heads(by_cell, cell)
            if record is None:
                continue
            heads = [by_cell[one] for one in (replace(cell, head=head) for head in HEADS) if one in by_cell]
            worst = max((one["exact"] for one in heads), key=lambda outcome: (outcome[1], outcome[2]))
            columns = [record[name] for name in ("published", "published, any partner", "exact", "strict")]
            lines.append(f"| {f} | {o} | " + " | ".join(percent(column) for column in (*columns, worst)) + " |")
    return "\n".join(["Unsuccessful / false positive, %", "", *lines, ""])


def further_table(by_cell: dict[Cell, Record]) -> str:
    """Return the outcomes beyond the protocol, the three heads together."""
    lines = [
        "| markers | outliers | hidden | told | true error | published | exact | exact, wrong of the answers |",
        "|---|---|---|---|---|---|---|---|",
    ]
    protocol = set(protocol_cells())
    for cell in by_cell:
        record = all_heads(by_cell, cell)
        if cell in protocol or cell.head != 0 or record is None:
            continue
        told = cell.told if cell.expected or cell.at_least else "nothing"
        error = "half to four times" if cell.noise_percent == DRAWN else f"{cell.noise_percent} %"
        right, _, wrong = record["exact"]
        lines.append(
            f"| {cell.markers} | {cell.outliers} | {cell.hidden} | {told} | {error} | {percent(record['published'])} "
            f"| {percent(record['exact'])} | {100 * wrong / max(right + wrong, 1):.3f} |"
        )
    return "\n".join(["Beyond the protocol: unsuccessful / false positive, %", "", *lines, ""])


def calibration_table(by_cell: dict[Cell, Record]) -> str:
    """Return how often answers of each stated probability are wrong, for each true error."""
    lines = [
        "| true error | stated probability | answers | wrong | wrong as stated |",
        "|---|---|---|---|---|",
    ]
    for noise in (100, 50, 200, 400, DRAWN):
        error = "half to four times" if noise == DRAWN else f"{noise} %"
        total = calibration_of(by_cell, noise)
        for low, high, (count, right, stated) in zip(
            PROBABILITY_EDGES, PROBABILITY_EDGES[1:], total, strict=False
        ):
            if count:
                wrong = f"{count - right:.0f} | {count - stated:.2f}"
                lines.append(f"| {error} | {low:g} to {high:g} | {count:.0f} | {wrong} |")
    return "\n".join(["Calibration", "", *lines, ""])
