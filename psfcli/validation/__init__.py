"""The convolution held against rays that scatter by chance."""
