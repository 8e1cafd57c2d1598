"""Loading: hostile bytes in, arrays out. Parsing happens in a limited child process; repairs in the worker itself."""
