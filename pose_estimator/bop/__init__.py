"""Reading and writing BOP datasets; meters and OpenCV camera frames outside, millimeters on disk.

- `dataset` opens a split; `scene` and `fields` parse and validate its JSON files.
- `pairs` and `find_pairs`: two-view pairs; `targets` and `results`: targets and result files.
- `depth_unit` is that of a single depth map.
- `objects`, `models_info` and `models`: the objects' geometry, symmetries and mesh files.
- `writer` and `coco` write scenes; `find_dataset` locates a dataset.
"""
