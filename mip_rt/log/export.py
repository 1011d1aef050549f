"""`mip-rt log export`: a log, or a part of it, for other programs; the ending of the file decides the format.

CSV: a header line with names and units, one column a number; packets as hexadecimal text. NPZ: one array a field as in the log, beside
`time_s`, `header` and `units` (JSON). Parquet: columns as in CSV, units and meanings as metadata of the columns. MCAP: see `mcap_export`.
"""

import json
from pathlib import Path

from mip_rt import optional
from mip_rt.errors import LogError
from mip_rt.log.selection import add_log, add_window, open_named, seconds, window

ENDINGS = (".csv", ".npz", ".parquet", ".mcap")
CSV_BLOCK = 2000  # rows formatted at a time


def add_arguments(parser) -> None:
    """Declares the action's arguments."""
    add_log(parser)
    add_window(parser)
    parser.add_argument("-o", "--output", metavar="FILE", required=True, help=f"ends in {', '.join(ENDINGS)}")
    parser.add_argument("--fields", metavar="A,B[0]", help="only these (CSV and Parquet; default: all)")


def run(arguments) -> int:
    """Exit code 0; says what was written."""
    output = Path(arguments.output)
    if output.suffix not in ENDINGS:
        raise LogError(f"there is no format for {output.name!r}.", f"End the file's name in one of {', '.join(ENDINGS)}.", "log_export")
    if arguments.fields and output.suffix in (".npz", ".mcap"):
        raise LogError(f"--fields does not go with {output.suffix}: it holds whole fields.", "Leave it out, or export CSV.", "log_export")
    log = open_named(arguments)
    times_s = seconds(log)
    mask = window(arguments, times_s)
    frames, times_s = log.frames[mask], times_s[mask]
    try:
        export(log.header, frames, times_s, output, arguments.fields)
    except OSError as error:
        raise LogError(f"{output} cannot be written: {error.strerror or error}.", "Name another file with -o.", "log_write") from error
    print(f"{output}: {len(frames)} rows, {output.stat().st_size} bytes")
    return 0


def export(header: dict, frames, times_s, output: Path, fields: str | None = None) -> None:
    """Writes the rows in the format of the file's ending.

    Raises:
        PackageMissing: the format needs a package that is not installed.
        LogError: a field is not in the log.
        OSError: the file cannot be written.
    """
    from mip_rt.log.columns import picked

    if output.suffix == ".csv":
        write_csv(picked(header, fields), frames, times_s, output)
    elif output.suffix == ".npz":
        write_npz(header, frames, times_s, output)
    elif output.suffix == ".parquet":
        write_parquet(header, picked(header, fields), frames, times_s, output)
    else:
        from mip_rt.log.mcap_export import write_mcap

        write_mcap(header, frames, output)


def write_csv(columns, frames, times_s, output: Path) -> None:
    """Comma-separated, numbers in the shortest form that reads back to the same value; "nan" and "inf" where they are."""
    with output.open("w", encoding="utf-8", newline="") as file:
        file.write(",".join(["time_s (s)"] + [f'"{c.title}"' if "," in c.title else c.title for c in columns]) + "\n")
        for begin in range(0, len(frames), CSV_BLOCK):
            block = frames[begin : begin + CSV_BLOCK]
            texts = [[repr(t) for t in times_s[begin : begin + CSV_BLOCK].tolist()]]
            for column in columns:
                values = column.of(block)
                texts.append([row.tobytes().hex() for row in values] if column.is_bytes else [repr(v) for v in values.tolist()])
            file.writelines(",".join(row) + "\n" for row in zip(*texts, strict=True))


def write_npz(header: dict, frames, times_s, output: Path) -> None:
    """Compressed; numpy.load gives the arrays by field."""
    import numpy as np

    units = {entry["name"]: entry["unit"] for entry in header["fields"]}
    arrays = {name: frames[name] for name in frames.dtype.names}
    with output.open("wb") as file:
        np.savez_compressed(file, time_s=times_s, header=json.dumps(header), units=json.dumps({"time_s": "s", **units}), **arrays)


def write_parquet(header: dict, columns, frames, times_s, output: Path) -> None:
    """Through pyarrow; the log's header is metadata of the table.

    Raises:
        PackageMissing: there is no pyarrow.
    """
    arrow = optional.load("pyarrow", "view", "Parquet")
    parquet = optional.load("pyarrow.parquet", "view", "Parquet")
    fields, arrays = [arrow.field("time_s", arrow.float64(), metadata={"unit": "s"})], [arrow.array(times_s)]
    for column in columns:
        values = column.of(frames)
        about = {"unit": column.unit, "meaning": column.meaning}
        if column.is_bytes:
            arrays.append(arrow.array([row.tobytes() for row in values], arrow.binary(values.shape[1])))
        else:
            arrays.append(arrow.array(values))
        fields.append(arrow.field(column.name, arrays[-1].type, metadata=about))
    table = arrow.Table.from_arrays(arrays, schema=arrow.schema(fields, metadata={"mip_rt_header": json.dumps(header)}))
    parquet.write_table(table, output)
