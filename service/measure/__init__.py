"""What accuracy costs: every rung of a mesh drawn and compared with the original, supersampled."""

from service.measure.stage import measure_mesh

__all__ = ["measure_mesh"]
