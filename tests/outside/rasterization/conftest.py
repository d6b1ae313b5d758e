"""gsplat's formulas for gsplat's own tests."""
import os

from formulas import formulas

formulas(os.environ['GSPLAT'])
