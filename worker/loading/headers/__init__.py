"""Own checks of each format's bytes, before any library sees them. Each module has `check(data, limits)`."""
