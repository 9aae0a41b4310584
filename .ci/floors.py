"""Print what runs with the package, each at the lowest version that pyproject.toml allows, as constraints for pip."""

import re
import tomllib
from pathlib import Path

PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]
OF_THEIR_TIME = ("pyparsing<3.3",)  # newer ones warn of what the oldest Matplotlib calls

of_extras = [needed for name in ("ros", "mesh", "viewer", "rerun", "las", "scale") for needed in EXTRAS[name]]
for needed in [*PROJECT["dependencies"], *of_extras]:
    name, floor = re.fullmatch(r"([\w.-]+)>=([\w.]+)(?:,<[\w.]+)?", needed).groups()
    print(f"{name}=={floor}")
print(*OF_THEIR_TIME, sep="\n")
