"""Reading and writing BOP datasets; meters and OpenCV camera frames outside, millimeters on disk.

- `dataset` opens a split; `scene` and `fields` parse and validate its JSON files; `layouts`
  recognizes layouts that are not read.
- `pairs` and `find_pairs`: two-view pairs; `targets` and `results`: targets and result files.
- `objects`, `models_info`, `symmetries` and `models`: the objects' geometry, symmetries and mesh
  files.
- `depth_unit` is that of a single depth map.
- `matching` finds the objects that an estimator knows; `pose_mistakes` lists common mistakes.
- `writer` and `coco` write scenes; `find_dataset` locates a dataset.
"""
