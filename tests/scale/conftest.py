"""What the tests of stores need that an installation may lack."""

import importlib.util

lacks = {name for name in ("zarr", "distributed") if importlib.util.find_spec(name) is None}
collect_ignore_glob = ["test_store*.py"] if "zarr" in lacks else ["test_store_[dc]*.py"] if lacks else []
