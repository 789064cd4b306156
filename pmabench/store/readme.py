"""The README.txt of every run folder: how to read it without pmabench, in lines that the tests execute."""

README_TEXT = """\
A run of pmabench: what one execution of one plan commanded, measured and found.

manifest.json      what, when, with which versions; who operated; hashes of the copied files
plan.json, *.yaml  the plan and the files that it was compiled from, as they were
events.jsonl       one JSON object per line: commands, trials, findings, the end
streams/           samples: NAME.parquet (closed run) or NAME.arrows (running or interrupted), NAME.json (columns)
guard.json         only where the program died: how the bench was vented after that
seal.json          status, and sha256 of every file; a run without it did not end by itself
notes/             what was noted since, also which trials are left out of fits and why; with hashes of its own

Samples are stored as the device gave them; SI = slope * raw + offset, with the scale of each column in NAME.json.
time_ns is the device's clock in nanoseconds; flags tell per sample what is wrong (0: nothing; 1 gap before,
2 late, 4 overrange, 8 stale, 16 time jump, 32 dropout, 64 slack, 128 suspect; bits add up). Where host_ns is told
(when the last sample of a batch came in, on the host's clock; in a closed run the metadata "arrivals" of the Parquet
file, pairs of device and host clock), streams of several devices have clocks that differ in offset and drift.

Closed run, Python with pandas and pyarrow, from inside this folder:

    import json, pathlib, pandas
    stream = sorted(pathlib.Path("streams").glob("*.parquet"))[0]
    frame = pandas.read_parquet(stream)
    for column in json.loads(stream.with_suffix(".json").read_text("utf-8"))["columns"]:
        scale = column["scale"]
        frame[column["name"]] = frame[column["name"]] * scale["slope"] + scale["offset"]
    frame["t"] = frame["time_ns"] / 1e9

Running or interrupted run, Python with pyarrow; stops at the last whole batch, checks each:

    import pathlib, zlib, pyarrow
    data = sorted(pathlib.Path("streams").glob("*.arrows"))[0].read_bytes()
    batches, end, head = [], b"0", zlib.crc32(data[:8 + int.from_bytes(data[4:8], "little")])
    reader = pyarrow.ipc.open_stream(data)
    try:
        while end == b"0":
            batch, note = reader.read_next_batch_with_custom_metadata()
            batch.validate(full=True)
            told = b"%d %s %s%s" % (len(batches), note[b"rows"], note[b"end"], note.get(b"host_ns", b""))
            crc = zlib.crc32(told, head)
            for column in batch.columns: crc = zlib.crc32(column.to_numpy(), crc)
            if crc != int(note[b"crc32"], 16): raise ValueError("its crc32 does not fit")
            batches.append(batch); end = note[b"end"]
    except Exception as torn: print("stopped before the first batch that is not whole:", repr(torn))
    table = pyarrow.Table.from_batches(batches, reader.schema)

Closed run, MATLAB (R2019a or newer), from inside this folder:

    found = dir(fullfile("streams", "*.parquet"));
    name = fullfile(found(1).folder, found(1).name);
    T = parquetread(name);
    about = jsondecode(fileread(replace(name, ".parquet", ".json")));
    for k = 1:numel(about.columns)
        c = about.columns(k);
        T.(c.name) = double(T.(c.name)) * c.scale.slope + c.scale.offset;
    end
    T.t = double(T.time_ns) / 1e9;
"""
