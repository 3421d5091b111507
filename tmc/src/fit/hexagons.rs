//! Hexagonal bins: how many points lie where, when dots would hide each other.
//!
//! Points are given in pixels; a bin is a regular hexagon with its corners up and down (Carr et al.
//! 1987). Owns the lattice; colours are the plot's.

use std::collections::BTreeMap;

/// A hexagon and how many points it holds.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Hexagon {
    /// Its middle, px.
    pub(super) centre: [f64; 2],
    /// Points in it.
    pub(super) count: usize,
}

/// From the middle of a hexagon to its corners.
pub(super) fn corners([x, y]: [f64; 2], radius: f64) -> Vec<[f64; 2]> {
    (0..6)
        .map(|i| {
            let (sin, cos) = (f64::from(i) * 60.0 - 90.0).to_radians().sin_cos();
            [x + radius * cos, y + radius * sin]
        })
        .collect()
}

/// Counts points in hexagons of that radius, px.
pub(super) fn hexagons(points: impl Iterator<Item = [f64; 2]>, radius: f64) -> Vec<Hexagon> {
    let (dx, dy) = (radius * 3f64.sqrt(), radius * 1.5);
    let centre = |column: i64, row: i64| {
        let odd = if row.rem_euclid(2) == 1 { 0.5 } else { 0.0 };
        [(column as f64 + odd) * dx, row as f64 * dy]
    };
    let mut counts = BTreeMap::<(i64, i64), usize>::new();
    for [x, y] in points {
        // The nearest middle of the two rows around the point.
        let below = (y / dy).floor() as i64;
        let nearest = [below, below + 1].map(|row| {
            let odd = if row.rem_euclid(2) == 1 { 0.5 } else { 0.0 };
            let column = (x / dx - odd).round() as i64;
            let [cx, cy] = centre(column, row);
            ((x - cx).powi(2) + (y - cy).powi(2), (row, column))
        });
        let [first, second] = nearest;
        let (_, key) = if first.0 <= second.0 { first } else { second };
        *counts.entry(key).or_default() += 1;
    }
    let hexagon = |((row, column), count): ((i64, i64), usize)| Hexagon {
        centre: centre(column, row),
        count,
    };
    counts.into_iter().map(hexagon).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_point_lies_in_the_hexagon_that_counts_it() {
        let points: Vec<[f64; 2]> =
            (0..500).map(|i| [f64::from(i * 37 % 200), f64::from(i * 91 % 150)]).collect();
        for point in &points {
            let found = hexagons(std::iter::once(*point), 6.0);
            let [x, y] = found[0].centre;
            assert!((point[0] - x).hypot(point[1] - y) <= 6.0 + 1e-9, "{point:?}: {found:?}");
        }
        let all = hexagons(points.iter().copied(), 6.0);
        assert_eq!(all.iter().map(|hexagon| hexagon.count).sum::<usize>(), points.len());
    }
}
