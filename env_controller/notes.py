"""What a designer sends for the record, as records of the journal."""

from __future__ import annotations

import numpy as np

from luxloop.campaign import Note
from luxloop.journal.image import image_of
from luxloop.journal.topics import LearnerRecord, NoteRecord, Record, ValidationStep, log_record, record
from luxloop.words import parse


def note_records(note: Note, sequence: int, log_time_ns: int) -> list[Record]:
    """What a designer sends for the record: of its learner, a result, a line of text, or several of them."""
    at = sequence, log_time_ns
    records = []
    if note.agent is not None:
        records.append(record("/agent", LearnerRecord(run=note.run, **note.agent.model_dump()), *at))
    if note.result is not None:
        records.append(record("/note", NoteRecord(run=note.run, designer=note.designer, result=note.result), *at))
    if note.validation is not None:
        step = parse(ValidationStep, {"run": note.run, **note.validation}, "validation")
        records.append(record("/validation", step, *at))
    for shot, rows in note.residual_maps.items():
        image = image_of(np.array(rows, np.float32), log_time_ns, shot)
        records.append(Record("/map/residual", *at, image))
    if note.log:
        records.append(log_record(note.log, *at, name=note.designer))
    return records
