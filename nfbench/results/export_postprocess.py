"""Declares the suite of exported data to cocopp, and runs cocopp on the data of all methods in this folder.

Usage, in an environment with cocopp: ``python postprocess.py [OPTIONS]``; the options are those of cocopp, such as
``-o FOLDER`` for the output. ``suite.json`` and ``functions.txt`` next to this file describe the suite.
"""

from __future__ import annotations

import json
import sys
from collections import OrderedDict
from pathlib import Path
from typing import Any

MARKERS = 6  # dimensions that cocopp's captions list, whether there are data or not


def declare(folder: Path) -> Any:
    """Declare the suite of the data in a folder to cocopp, and return the module cocopp.

    COCO's own suite ``bbob`` is known to cocopp, which is left unchanged then, except that runs keep equal weights.
    """
    import cocopp
    from cocopp import genericsettings, pproc, testbedsettings

    about = json.loads((folder / "suite.json").read_text(encoding="utf-8"))
    genericsettings.balance_instances = False  # every run counts the same, as in targets.csv
    if about["suite"] in testbedsettings.suite_to_testbed:
        return cocopp
    name = f"Testbed_{about['suite']}".replace("-", "_").replace("+", "_")
    vars(testbedsettings)[name] = testbed(folder, about)
    testbedsettings.suite_to_testbed[about["suite"]] = name
    pproc.DataSetList.dictByFuncGroupSingleObjective = lambda self: OrderedDict()  # these groups are those of bbob
    pproc.DataSetList.getFuncGroups = lambda self: OrderedDict()
    return cocopp


def testbed(folder: Path, about: dict[str, Any]) -> type:
    """Return the class with the settings of a suite: its functions, dimensions and targets.

    folder: the folder with ``functions.txt``. about: contents of ``suite.json``.
    """
    from cocopp import testbedsettings

    functions = {int(number): text for number, text in about["functions"].items()}
    dimensions = tuple(about["dimensions"])
    shown = (dimensions[0], dimensions[-1])
    others = tuple(range(dimensions[-1] + 1, dimensions[-1] + 1 + max(MARKERS - len(dimensions), 0)))
    names = str(folder / "functions.txt")
    settings = testbedsettings.GECCOBBOBTestbed.settings | {
        "name": about["suite"],
        "info_filename": names,
        "shortinfo_filename": names,
        "short_names": functions,
        "flex_navigation_json_file": "",
        "dimensions_to_display": dimensions + others,
        "goto_dimension": dimensions[-1],
        "rldDimsOfInterest": shown,
        "tabDimsOfInterest": shown,
        "functions_with_legend": (min(functions), max(functions)),
        "first_function_number": min(functions),
        "last_function_number": max(functions),
        "reference_algorithm_filename": None,
        "reference_algorithm_displayname": None,
        "instancesOfInterest": None,
        "plots_on_main_html_page": [f"pprldmany_{n:02d}D_noiselessall.svg" for n in dimensions],
    }

    class Suite(testbedsettings.GECCOBBOBTestbed):  # type: ignore[misc]
        """The functions of one study."""

        def __init__(self, target_values: Any) -> None:
            for key, value in settings.items():
                setattr(self, key, value)
            self.instantiate_attributes(target_values)

        def filter(self, data: Any) -> Any:
            """All data are of this suite."""
            return data

    return Suite


def main(arguments: list[str]) -> None:
    """Run cocopp on the data of all methods."""
    folder = Path(__file__).resolve().parent
    about = json.loads((folder / "suite.json").read_text(encoding="utf-8"))
    methods = [str(folder / name) for name in about["algorithms"].values()]
    declare(folder).main([*arguments, *methods])


if __name__ == "__main__":
    main(sys.argv[1:])
