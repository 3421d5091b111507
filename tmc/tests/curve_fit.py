"""Fits points with SciPy's curve_fit; prints parameters and standard errors as JSON.

Arguments: model, file of points, start values as v_f,k_j[,lambda].
"""
import json
import sys

import numpy
from scipy.optimize import curve_fit


def greenshields(k, v_f, k_j):
    return v_f * (1 - k / k_j)


def newell(k, v_f, k_j, slope):
    return v_f * (1 - numpy.exp(-slope / v_f * (1 / k - 1 / k_j)))


model, path, start = sys.argv[1:]
with open(path) as file:
    header = file.readline().strip().split(",")
    columns = [header.index("density_veh_km"), header.index("speed_kmh")]
    rows = [line.strip().split(",") for line in file]
points = numpy.array([[float(row[c]) for c in columns] for row in rows])
with numpy.errstate(all="ignore"):
    found, covariance = curve_fit(
        {"greenshields": greenshields, "newell": newell}[model],
        points[:, 0], points[:, 1], p0=[float(s) for s in start.split(",")], maxfev=100000)
print(json.dumps({"parameters": list(found), "errors": list(numpy.sqrt(numpy.diag(covariance)))}))
