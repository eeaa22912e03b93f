"""``scanloom labels``: the labels of people, of a recording.

- ``open_store.py``: the label store of a recording, beside it or where it is named.
- ``chosen_layers.py``: the layers of a store that a command works on.
- ``export_labels.py``, ``import_labels.py``, ``merge_stores.py``: labels from and to files, and
  from another store. What comes in never takes a label away unasked.
- ``compare_layers.py``: agreement of layers; ``adjudicate_layers.py``: where they disagree, and a
  layer of what most of them say; ``score_layer.py``: a layer against known answers.
- ``read_journal.py``: the last actions, and what there is by class, layer and annotator.
- ``evaluate_layer.py``: a recording's classes against a layer, and better thresholds, of
  ``labelled_frames.py``: the frames with labels, matched by the chain; ``measures.py``: the classes
  and Fig. 6 of Xu 2024 by a layer in place of a truth; ``suggestions.py``: thresholds fitted on it.
"""
