"""Where the runs of a sweep happen: processes, dask."""
