"""The slow float64 twins that the native kernels are held to, apart from what runs: nothing else here imports them."""
