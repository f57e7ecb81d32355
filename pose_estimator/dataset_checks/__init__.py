"""The command ``check-data``: a linter of BOP datasets.

`checks` runs all checks in order; each of `files`, `cameras`, `models`, `model_folders`, `poses`,
`boxes`, `images`, `depth`, `projection` and `pairs` is one group of them. `units` lists the units
that explain a wrong length, `bop.pose_mistakes` the mistakes that explain a wrong projection.
`findings` collects, `coverage` counts what was checked, `check_data` prints, `overlays` draws.
"""
