"""The command ``compare``: renders missing test sets, then runs the study on them."""

from ...core.device import check_device
from ...pose_estimator.study.config import CompareConfig


def compare(config: CompareConfig) -> None:
    """Runs the comparative study and writes results.json, report.html and figures/ to its folder.

    Raises:
        InputError: if no method can be run, the device is not available, or the folder contains
            another study's test sets or outcomes.
        FileNotFoundError: if weights are missing.
        GraphicsUnavailable: if a test set must be rendered and there is no OpenGL to render with.
    """
    from ...core.results import write_results
    from ...pose_estimator.study.report import write_report

    if not config.report_only:
        check_device(config.device)
        from ...pose_estimator.study.measure import StudySet
        from ...pose_estimator.study.plan import TESTS
        from ...pose_estimator.study.run import Study
        from .study_data import ensure_test_set

        tests = {
            name: StudySet.open(name, ensure_test_set(name, config.test_data, config.quick))
            for name in TESTS
        }
        records = Study(config.reduced(), tests).run()
        write_results(
            config.out / "results.json", records, command=config.command(), seed=config.seed
        )
    page = write_report(config.out)
    print(f"results: {config.out / 'results.json'}")
    print(f"page: {page}")
