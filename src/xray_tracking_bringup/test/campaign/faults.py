"""The table of all faults."""
import geometry_faults
import image_faults
import process_faults
from fault import FAULTS

# Whoever imports the table has all of it.
__all__ = ["FAULTS", "geometry_faults", "image_faults", "process_faults"]
