"""Camera poses of generated datasets.

``view_spread.py`` samples views on a sphere, ``hand_held.py`` smooth paths (``sequence.py`` fits
them to a scene), ``stereo.py`` the pairs of a rig.
"""
