"""Reports of evaluations: results folders in, one self-contained HTML file out."""
