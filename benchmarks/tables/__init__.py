"""The tables and figures of docs/results: each module makes one and can be run alone."""
