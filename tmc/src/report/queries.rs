//! The questions that a report asks of a cluster, in SQL: the sums of `pass`.
//!
//! The answers are sums and counts: their number grows with lanes, cells, bins and days, not with
//! windows. `tests/ballista.rs` holds that a cluster's report has the bytes of one process.

use super::summary::{BINS, LANES};
use crate::store::{self, DAY_MS};
use verge_messages::{LONGEST_WINDOW_S, SHORTEST_WINDOW_S};

/// The archive's name in the questions.
pub(super) const TABLE: &str = "density";
const BIN_MS: i64 = DAY_MS / BINS as i64;
/// 1970-01-01 was a Thursday; Monday is 0.
const EPOCH_WEEKDAY: i64 = 3;
/// Added to times, so that those before 1970 are not negative and `/` rounds down: whole weeks.
const PAST_MS: i64 = 7 * DAY_MS * 5000;

/// A density; one that no box measures counts as not known.
const DENSITY: &str =
    "(CASE WHEN density_veh_km BETWEEN 0 AND 10000 THEN CAST(density_veh_km AS DOUBLE) END)";

/// The parts of a density's error are known.
const IS_STATED: &str = "density_veh_km BETWEEN 0 AND 10000 AND density_se BETWEEN 0 AND 10000 \
    AND calibration_se BETWEEN 0 AND 1000000 AND counting_se BETWEEN 0 AND 1000000";

/// Extent of a report.
#[derive(Clone, Debug)]
pub(super) struct Scope {
    /// The site.
    pub site: String,
    /// Days since 1970, UTC.
    pub days: Vec<i64>,
    /// Length of the windows, s; none: all of them.
    pub window_s: Option<i32>,
    /// Local time ahead of UTC.
    pub offset_ms: i64,
}

impl Scope {
    /// Condition on site, days, lanes and windows. The first two are folders, so that no other
    /// file is opened. The others pass over what an older archiver let in: what is not a box's.
    fn condition(&self) -> String {
        let days: Vec<_> = self.days.iter().map(|day| format!("'{}'", store::date(*day))).collect();
        let days = days.join(",");
        let site = self.site.replace('\'', "''");
        let window = self.window_s.map_or(String::new(), |s| format!(" AND window_s = {s}"));
        format!(
            "site = '{site}' AND date IN ({days}) \
             AND lane BETWEEN 1 AND {LANES} AND window_s BETWEEN {SHORTEST_WINDOW_S} AND \
             {LONGEST_WINDOW_S} AND CAST(\"from\" AS BIGINT) >= 0{window}"
        )
    }

    /// A row's local time, ms, from a Monday's beginning.
    fn local(&self) -> String {
        let shift = PAST_MS + EPOCH_WEEKDAY * DAY_MS + self.offset_ms;
        format!("CAST(\"from\" AS BIGINT) + {shift}")
    }
}

/// Average day by lane, week, completeness: of whole lanes, in one pass.
///
/// `weekday` and `bin` are null in the sums by `day`, and `day` in those by time. Squares have 24
/// bits as densities have, so that their sums are exact as well.
pub(super) fn lanes(scope: &Scope) -> String {
    let (condition, local) = (scope.condition(), scope.local());
    format!(
        "SELECT window_s, lane, weekday, bin, day,
            count(*) AS archived, count(density) AS known, sum(density) AS density,
            count(variance) AS stated, sum(variance) AS variance,
            sum(calibration) AS calibration, sum(counting) AS counting
        FROM (
            SELECT window_s, lane, {DENSITY} AS density,
                CASE WHEN {IS_STATED} THEN CAST(density_se * density_se AS DOUBLE) END AS variance,
                CASE WHEN {IS_STATED} THEN CAST(calibration_se AS DOUBLE) END AS calibration,
                CASE WHEN {IS_STATED} THEN CAST(counting_se AS DOUBLE) END AS counting,
                ({local}) / {DAY_MS} % 7 AS weekday, ({local}) % {DAY_MS} / {BIN_MS} AS bin,
                (CAST(\"from\" AS BIGINT) + {PAST_MS}) / {DAY_MS} - {PAST_MS} / {DAY_MS} AS day
            FROM {TABLE} WHERE {condition} AND cell IS NULL)
        GROUP BY GROUPING SETS ((window_s, lane, weekday, bin), (window_s, lane, day))"
    )
}

/// Average day by position, and with it the density along the road: of cells.
///
/// `first` is the first window that has a density; position and length tell lane tables apart.
pub(super) fn cells(scope: &Scope) -> String {
    let (condition, local) = (scope.condition(), scope.local());
    format!(
        "SELECT lane, position_m, length_m, bin, count(*) AS archived,
            count(density) AS known, sum(density) AS density, min(since) AS first
        FROM (
            SELECT lane, position_m, length_m, {DENSITY} AS density,
                ({local}) % {DAY_MS} / {BIN_MS} AS bin,
                CASE WHEN {DENSITY} IS NOT NULL THEN CAST(\"from\" AS BIGINT) END AS since
            FROM {TABLE} WHERE {condition} AND cell IS NOT NULL)
        GROUP BY lane, position_m, length_m, bin"
    )
}
