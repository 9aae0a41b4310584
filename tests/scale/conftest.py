"""What these tests need that an installation may lack."""

import importlib.util

collect_ignore = []
if importlib.util.find_spec("zarr") is None:
    collect_ignore += [
        "test_store.py",
        "test_store_counts.py",
        "test_store_heat.py",
        "test_store_filter.py",
        "test_store_dask.py",
        "test_store_commands.py",
    ]
elif importlib.util.find_spec("distributed") is None:
    collect_ignore += ["test_store_dask.py", "test_store_commands.py"]
