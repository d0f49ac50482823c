"""The workbench for programs and notebooks: `import kincal` gives these names.

arm, data = kincal.Arm.load("wam"), kincal.Data.load("poses.csv")
kincal.compare(arm, data)                       what the model leaves, and where
kincal.diagnose(arm, data)                      which effect is missing
fitted = kincal.fit(arm, data, ["backlash[4]"])
fitted.predict(q, direction=d), fitted.correct(q, direction=d), fitted.export("c", "calibrated.c")
"""

from .fitted import Fitted, fit
from .inputs import Arm, Data
from .verdicts import Compared, Diagnosed, compare, diagnose

__all__ = ["Arm", "Compared", "Data", "Diagnosed", "Fitted", "compare", "diagnose", "fit"]
