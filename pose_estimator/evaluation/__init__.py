"""The command ``evaluate``: errors of estimated poses on pairs of views.

``metrics.py`` has ADD and ADD-S, ``evaluate_pairs.py`` runs an estimator on a dataset's pairs,
``score_results.py`` scores a BOP result file, ``explain_results.py`` names the mistake in one,
``outcomes.py`` summarizes and prints, and ``intervals.py`` and ``score_interval.py`` have the
intervals of means.
"""
