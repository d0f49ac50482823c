"""A whole calibration in simulation: start it, follow it, evaluate it.

The processes are started by `python -m kincal_sim.launch`; this package only listens, reviews as the ground
would, and reads what the run left: run.lcmlog, truth.json, launch.json.

request: what to run and what is expected. processes: the launcher. follow: poses as they come. perform: start
to end. evaluate: against the ground truth. criteria: what a run has to meet. compare: all of it."""

from .compare import calibrate, compare_acquisitions, run_result
from .criteria import criteria
from .evaluate import Evaluator, GroundTruth, coef_name
from .finished import Finished
from .follow import Observer, decide
from .perform import perform
from .processes import Processes, read_json
from .request import Expectation, Request, read_expectation

__all__ = [
    "Evaluator",
    "Expectation",
    "Finished",
    "GroundTruth",
    "Observer",
    "Processes",
    "Request",
    "calibrate",
    "coef_name",
    "compare_acquisitions",
    "criteria",
    "decide",
    "perform",
    "read_expectation",
    "read_json",
    "run_result",
]
