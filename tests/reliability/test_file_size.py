"""A run whose files may not grow any more ends as failed, with all that was written (R8) and a seal (R13)."""

import random

import pytest

from pmabench.base.errors import RecordError
from pmabench.store.folder import MANIFEST, read_seal
from pmabench.store.reader import open_run
from pmabench.store.seal import FOR_SEAL
from tests.reliability.cases import cases
from tests.reliability.test_disk_faults import what_is_wrong
from tests.store.runs import begin, block
from tests.store.test_writer import _FileSizeLimit

CASES = cases(30)


@pytest.mark.timeout(60 + CASES)
def test_a_file_that_cannot_grow_fails_the_run(tmp_path, record_property):
    rng = random.Random(6)
    record_property("cases", CASES)
    wrong = []
    for number in range(CASES):
        limit = rng.choice((rng.randrange(1, FOR_SEAL), rng.randrange(FOR_SEAL, 5 * FOR_SEAL)))
        parent = tmp_path / f"{number}"
        rows, reported = 0, ""
        with _FileSizeLimit(limit):
            try:
                writer = begin(parent)
                try:
                    while rows < 40_000:
                        writer.append("daq", *block(rows, 100))
                        rows += 100
                        writer.event("mark", rows / 500, rows=rows)
                finally:
                    writer.close("error", "the record failed")
            except RecordError as error:
                reported = "reported" if error.exit_code == 7 and "File too large" in str(error) else str(error)
        wrong += [f"limit {limit}: {what}" for what in what_is_wrong(parent / "run", reported or "said nothing", rows)]
        if (parent / "run" / MANIFEST).exists() and open_run(parent / "run").status == "finished":
            wrong.append(f"limit {limit}: is finished")
        seal = read_seal(parent / "run") if limit >= FOR_SEAL else None
        if limit >= FOR_SEAL and (seal is None or "File too large" not in seal["why"]):
            wrong.append(f"limit {limit}: has no seal with the cause")
    assert not wrong, "\n".join(wrong[:10])
