"""People's labels: their journal, its history, their agreement, and files that others read.

the journal; start in ``store.py``
    store.py            ``LabelStore``: label, undo, redo, and all that is read
    identity.py         whose labels they are, and of which recording
    action.py           an action, and what it changed
    journal.py          actions appended and read
    undo_stacks.py      what each annotator can undo and redo
    labels_in_force.py  the labels that the changes add up to
    layer_view.py       a layer as it was after one action, for a run
    input_cache.py      digests of the recording's files
its database
    schema.py           the tables, and what the database itself refuses
    address.py          a file, or ``postgresql://…``
    sqlite_database.py, postgresql_database.py   opened, made, checked
    store_check.py      what is no sound store of this recording
    database.py         transactions that read and that write
    database_errors.py  errors as lines that say what to do
several annotators
    aligned_layers.py   what each layer says of each sample
    agreement.py        measures of agreement (``agreement_counts.py``, ``coefficients.py``)
    runs.py             runs of neighbouring samples of one class
    disagreements.py    where layers differ, and labels by majority
"""
