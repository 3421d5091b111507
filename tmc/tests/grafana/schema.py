"""Holds dashboards to Grafana's published schema: schema.py DASHBOARD.json ...

Grafana Labs' own types (PyPI: grafana-foundation-sdk) read each file and write it again. A field that
is in the file and not in what comes back is none of the schema, and so is a value that changed.
"""

import json
import sys

from grafana_foundation_sdk.cog.encoder import JSONEncoder
from grafana_foundation_sdk.cog.plugins import register_default_plugins
from grafana_foundation_sdk.models.dashboard import Dashboard

# Left by the schema to the data source: Prometheus' own keys of variables and annotations.
OWN = {"definition", "titleFormat", "step"}


def lost(ours, theirs, path):
    """Every difference, as a path with words."""
    if isinstance(ours, dict) and isinstance(theirs, dict):
        for key, value in ours.items():
            if key in theirs:
                yield from lost(value, theirs[key], f"{path}/{key}")
            elif value not in ({}, [], None) and key not in OWN:
                yield f"{path}/{key}: the schema does not know it"
    elif isinstance(ours, list) and isinstance(theirs, list) and len(ours) == len(theirs):
        for index, pair in enumerate(zip(ours, theirs)):
            yield from lost(*pair, f"{path}/{index}")
    elif ours != theirs:
        yield f"{path}: {ours!r} becomes {theirs!r}"


def main():
    register_default_plugins()
    faults = []
    for name in sys.argv[1:]:
        with open(name, encoding="utf-8") as file:
            ours = json.load(file)
        theirs = json.loads(JSONEncoder().encode(Dashboard.from_json(ours)))
        faults += lost(ours, theirs, name)
    for fault in faults:
        print(fault, file=sys.stderr)
    sys.exit(1 if faults else 0)


main()
