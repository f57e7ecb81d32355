"""Training samples from BOP datasets: packed crops, augmentation, sampling.

Start at ``dataset.py``: ``TrainingSet`` draws crops, pairs of views and frames. It reads crops that
``crop_packing.py`` packed once (format: ``crops.py``) and augments them (``augmentation.py``,
``cut_and_paste.py``, ``depth_augmentation.py``); ``target_sample.py`` is what it returns.
"""
