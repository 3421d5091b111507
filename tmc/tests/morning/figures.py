"""The figures of the morning page beside DuckDB's on the same Parquet.

    figures.py ARCHIVE REPORT NOW_MS

Reads REPORT/last_day.csv and REPORT/sites.csv; ends with an error that names the first difference.
"""

import csv
import datetime
import math
import sys

import duckdb

archive, report, now = sys.argv[1], sys.argv[2], int(sys.argv[3])
QUARTER = 900_000
lanes = f"""(SELECT site, epoch_ms("from") // {QUARTER} AS quarter, * EXCLUDE (site)
    FROM read_parquet('{archive}/site=*/date=*/density.parquet', hive_partitioning = true)
    WHERE cell IS NULL AND epoch_ms("from") < {now})"""


def close(what, found, expected):
    """Equal to the digits that the table has, or both not known."""
    if expected is None or found == "":
        assert expected is None and found == "", f"{what}: {found!r}, DuckDB {expected}"
    else:
        assert math.isclose(float(found), expected, rel_tol=2e-6, abs_tol=6e-4), (
            f"{what}: {found}, DuckDB {expected}"
        )


quarters = {
    (site, quarter): values
    for site, quarter, *values in duckdb.sql(
        f"""SELECT site, quarter, avg(density_veh_km), avg(density_low90), avg(density_high90),
            sum(flow), sum(flow * speed) / sum(flow)
        FROM (SELECT site, quarter, lane, density_veh_km, density_low90, density_high90,
                flow_veh_h AS flow, speed_kmh AS speed FROM {lanes})
        GROUP BY site, quarter"""
    ).fetchall()
}
usual = {
    (site, quarter): bands
    for site, quarter, bands in duckdb.sql(
        f"""WITH means AS (SELECT site, quarter, avg(density_veh_km) AS density FROM {lanes}
                GROUP BY site, quarter HAVING count(density_veh_km) > 0),
            wanted AS (SELECT DISTINCT site, unnest(range({now} // {QUARTER} - 96, {now} // {QUARTER}))
                AS quarter FROM means)
        SELECT wanted.site, wanted.quarter, quantile_cont(density, [0.1, 0.5, 0.9])
        FROM wanted JOIN means ON means.site = wanted.site
            AND (wanted.quarter - means.quarter) % 672 = 0
            AND wanted.quarter - means.quarter BETWEEN 672 AND 5376
        GROUP BY wanted.site, wanted.quarter HAVING count(*) >= 3"""
    ).fetchall()
}
rows = list(csv.DictReader(open(f"{report}/last_day.csv")))
for row in rows:
    at = round(datetime.datetime.fromisoformat(row["from"]).timestamp() * 1000) // QUARTER
    key = (row["site"], at)
    density, low, high, flow, speed = quarters.get(key, [None] * 5)
    close(f"{key} density", row["density_veh_km"], density)
    close(f"{key} low", row["low90_veh_km"], low)
    close(f"{key} high", row["high90_veh_km"], high)
    close(f"{key} flow", row["flow_veh_h"], flow)
    close(f"{key} speed", row["speed_kmh"], speed)
    for name, value in zip(["usual_low", "usual_middle", "usual_high"], usual.get(key, [None] * 3)):
        close(f"{key} {name}", row[f"{name}_veh_km"], value)

means = duckdb.sql(f"SELECT site, avg(density_veh_km), count(*) FROM {lanes} GROUP BY site").fetchall()
sites = {row["site"]: row for row in csv.DictReader(open(f"{report}/sites.csv"))}
assert sites.keys() == {site for site, *_ in means}, sites.keys()
for site, mean, _ in means:
    found = float(sites[site]["mean_density_veh_km"])
    assert abs(found - mean) <= 0.005 + 1e-9, f"{site}: mean {found}, DuckDB {mean}"
print(f"{len(rows)} quarter hours and {len(means)} sites are DuckDB's")
