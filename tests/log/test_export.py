"""`mip-rt log export`: what is read back from every format are the log's values, units and times, none missing."""

import base64
import csv
import json

import numpy as np
import pytest

from mip_rt import cli
from mip_rt.log import open as open_log
from mip_rt.log.columns import columns
from mip_rt.log.selection import seconds


@pytest.fixture
def hard(make_log, rows):
    """A log of random bits: every kind of number, NaN and infinity among them."""
    rng = np.random.default_rng(1)
    frames = rows(300)
    keep = {name: frames[name].copy() for name in ("tick", "edge_ns")}
    for name in frames.dtype.names:
        if frames[name].dtype.kind == "f":
            frames[name] = rng.standard_normal(frames[name].shape) * 10.0 ** rng.integers(-12, 12, frames[name].shape)
        elif frames[name].dtype.kind == "i":
            frames[name] = rng.integers(-(2**53), 2**53, frames[name].shape)
        else:
            frames[name] = rng.integers(0, 256, frames[name].shape)
    frames["battery_v"][7], frames["remote_age_s"][8], frames["gyro_rad_s"][9, 1] = np.nan, np.inf, -np.inf
    frames["state"], frames["fault"] = 4, 0
    for name, values in keep.items():
        frames[name] = values
    return make_log(frames, clock={"monotonic_ns": 500_000_000, "realtime_ns": 1_700_000_000_000_000_000})


def export(path, output, *arguments):
    assert cli.main(["log", "export", str(path), "-o", str(output), *arguments]) == 0
    return open_log(path)


def same(a, b):
    return np.array_equal(np.asarray(a, float), np.asarray(b, float), equal_nan=True)


def test_csv(hard, tmp_path, capsys):
    log = export(hard, tmp_path / "a.csv")
    assert "300 rows" in capsys.readouterr().out
    with (tmp_path / "a.csv").open(newline="") as file:
        head, *lines = csv.reader(file)
    every = columns(log.header)
    assert head == ["time_s (s)", *(c.title for c in every)] and len(lines) == 300
    assert "gyro_rad_s[0] (rad/s)" in head and "estimates[1].roll_rate_rad_s (rad/s)" in head and "battery_v (V)" in head
    assert same([line[0] for line in lines], seconds(log))
    for i, column in enumerate(every, 1):
        values = [line[i] for line in lines]
        if column.is_bytes:
            assert [bytes.fromhex(v) for v in values] == [row.tobytes() for row in column.of(log.frames)]
        elif column.of(log.frames).dtype.kind == "i":
            assert [int(v) for v in values] == column.of(log.frames).tolist()
        else:
            assert same(values, column.of(log.frames)), column.name


def test_csv_of_some_fields_and_of_a_window(fallen, tmp_path):
    log = export(fallen, tmp_path / "a.csv", "--fields", "battery_v,estimates[kf].roll_rad", "--from", "2", "--to", "2.5")
    with (tmp_path / "a.csv").open() as file:
        head, *lines = csv.reader(file)
    assert head == ["time_s (s)", "battery_v (V)", "estimates[2].roll_rad (rad)"] and len(lines) == 101
    assert same([line[2] for line in lines], log.frames["estimates"][400:501, 2, 0])


def test_npz(hard, tmp_path):
    log = export(hard, tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as found:
        assert json.loads(str(found["header"]))["config"] == log.config
        units = json.loads(str(found["units"]))
        assert set(found.files) == {"time_s", "header", "units", *log.frames.dtype.names}
        for entry in log.header["fields"]:
            assert units[entry["name"]] == entry["unit"]
            assert found[entry["name"]].tobytes() == np.ascontiguousarray(log.frames[entry["name"]]).tobytes()


def test_parquet(hard, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow writes Parquet; it is not installed")
    log = export(hard, tmp_path / "a.parquet")
    table = parquet.read_table(tmp_path / "a.parquet")
    assert json.loads(table.schema.metadata[b"mip_rt_header"])["row_bytes"] == log.frames.itemsize
    every = columns(log.header)
    assert table.column_names == ["time_s", *(c.name for c in every)]
    for column in every:
        field, values = table.schema.field(column.name), table[column.name]
        assert field.metadata == {b"unit": column.unit.encode(), b"meaning": column.meaning.encode()}
        if column.is_bytes:
            assert values.to_pylist() == [row.tobytes() for row in column.of(log.frames)]
        else:
            assert values.to_numpy().tobytes() == np.ascontiguousarray(column.of(log.frames)).tobytes(), column.name


def assert_foxglove_reads(schema):
    """What Foxglove's parseJsonSchema.ts accepts: any other type, encoding or an array of arrays makes the whole topic unreadable there."""
    assert schema["type"] == "object"
    for name, entry in schema["properties"].items():
        assert entry["type"] in ("boolean", "string", "number", "integer", "array"), name
        assert entry.get("contentEncoding") in (None, "base64"), name
        if entry["type"] == "array":
            assert entry["items"]["type"] in ("boolean", "string", "number", "integer"), name


def read_mcap(path):
    """(reader's summary, messages by topic as (schema, log time, decoded), metadata by name, attachments by name), by the mcap library."""
    mcap = pytest.importorskip("mcap.reader", reason="the mcap package writes and reads MCAP; it is not installed")
    messages = {}
    with open(path, "rb") as file:
        reader = mcap.make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        for schema, channel, message in reader.iter_messages():
            assert schema.encoding == "jsonschema" and channel.message_encoding == "json"
            assert_foxglove_reads(json.loads(schema.data))
            messages.setdefault(channel.topic, []).append((json.loads(schema.data), message.log_time, json.loads(message.data)))
        metadata = {entry.name: entry.metadata for entry in reader.iter_metadata()}
        attachments = {entry.name: entry.data for entry in reader.iter_attachments()}
    return summary, messages, metadata, attachments


def test_mcap_has_all_fields_units_and_times(hard, tmp_path):
    pytest.importorskip("mcap", reason="the mcap package writes and reads MCAP; it is not installed")
    log = export(hard, tmp_path / "a.mcap")
    summary, messages, metadata, attachments = read_mcap(tmp_path / "a.mcap")
    assert summary.statistics.message_count == 300 * len(messages)
    assert set(messages) == {"/mip/timing", "/mip/supervisor", "/mip/remote", "/mip/reference", "/mip/estimator", "/mip/command", "/mip/sensors",
                             "/mip/estimate/one", "/mip/estimate/two"}  # fmt: skip
    expected_ns = (log.frames["edge_ns"] - 500_000_000 + 1_700_000_000_000_000_000).tolist()
    found = {}
    for topic, entries in messages.items():
        assert [time_ns for _, time_ns, _ in entries] == expected_ns
        for name, schema in entries[0][0]["properties"].items():
            found[topic, name] = (schema, [data[name] for _, _, data in entries])
    by_name = {name: value for (topic, name), value in found.items() if not topic.startswith("/mip/estimate/")}
    for entry in log.header["fields"]:
        if entry["name"] == "estimates":
            continue
        schema, values = by_name[entry["name"]]
        assert schema["description"] == f"{entry['meaning']} [{entry['unit']}]"
        recorded = log.frames[entry["name"]]
        if entry["dtype"].endswith("u1"):
            assert [base64.b64decode(v) for v in values] == [row.tobytes() for row in recorded]
            continue
        kind = schema["items"] if entry["shape"] else schema
        assert kind["type"] == ("integer" if recorded.dtype.kind == "i" else "number")
        finite = np.where(np.isfinite(recorded), recorded, np.nan) if recorded.dtype.kind == "f" else recorded
        assert np.array_equal(np.array(values, finite.dtype), finite, equal_nan=recorded.dtype.kind == "f"), entry["name"]
    for slot, name in enumerate(("one", "two")):
        for i, element in enumerate(log.header["estimate_names"]):
            schema, values = found[f"/mip/estimate/{name}", element]
            assert same(values, log.frames["estimates"][:, slot, i]) and schema["description"].endswith("rad/s]" if "rate" in element else "rad]")
    assert by_name["state_name"][1] == ["BALANCING"] * 300 and by_name["fault_code"][1][0] == "none"
    assert attachments["config.yaml"].decode() == log.config and json.loads(attachments["header.json"]) == log.header
    assert json.loads(metadata["mip-rt"]["clock"]) == log.header["clock"] and metadata["mip-rt"]["source_hash"] == log.header["source_hash"]


def test_mcap_of_a_log_that_does_not_name_its_estimators(make_log, rows, tmp_path):
    pytest.importorskip("mcap", reason="the mcap package writes and reads MCAP; it is not installed")
    frames = rows(5)
    frames["estimates"][:, 1, 2] = 0.5
    export(make_log(frames, estimators=[]), tmp_path / "a.mcap")
    _, messages, _, _ = read_mcap(tmp_path / "a.mcap")
    width = frames["estimates"].shape[2]
    assert messages["/mip/sensors"][0][2]["estimates"][width + 2] == 0.5 and not any(topic.startswith("/mip/estimate/") for topic in messages)


def test_mcap_names_limits_and_faults_in_words(fallen, tmp_path):
    """Whoever looks at a log in Foxglove has no table of bits at hand."""
    pytest.importorskip("mcap", reason="the mcap package writes and reads MCAP; it is not installed")
    log = export(fallen, tmp_path / "a.mcap", "--last", "1")
    _, messages, _, _ = read_mcap(tmp_path / "a.mcap")
    last = messages["/mip/supervisor"][-1][2]
    assert last["state_name"] == "FAULT" and last["fault_code"] == "tipped" and "tipped" in last["limit_names"].split()
    assert len(messages["/mip/timing"]) == 200 and set(messages) >= {f"/mip/estimate/{name}" for name in log.header["estimators"]}


def test_refusals(fallen, tmp_path, capsys, monkeypatch):
    for arguments, words in (
        (["-o", "a.xls"], "there is no format"),
        (["-o", str(tmp_path / "a.npz"), "--fields", "duty"], "does not go with"),
        (["-o", str(tmp_path / "a.csv"), "--fields", "dutty"], "did you mean 'duty'"),
        (["-o", str(tmp_path / "no" / "a.csv")], "cannot be written"),
    ):
        assert cli.main(["log", "export", str(fallen), *arguments]) == 3
        assert words in capsys.readouterr().err
    monkeypatch.setitem(__import__("sys").modules, "mcap.writer", None)
    assert cli.main(["log", "export", str(fallen), "-o", str(tmp_path / "a.mcap")]) == 3
    assert 'package_missing: MCAP needs the Python package mcap' in capsys.readouterr().err
