"""View banks: offline datasets for the replay environment.

``bank`` is the data and its file format, ``mirror`` the left-right augmentation.
"""
