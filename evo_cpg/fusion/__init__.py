"""Few large kernels instead of many small ones: array programs as scalars per individual."""
