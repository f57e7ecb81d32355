"""Records view banks: the command ``record-bank``.

``record_bank`` is the command and ``config`` its options; ``recorder`` records simulated scenes,
``real_bank`` a BOP dataset of photographs.
"""
