"""The machine: back end, threads and lock, kernel cache, memory, guarded and atomic files, journals."""
