//! Lanes between neighbouring lines.
//!
//! Owns which drawn lines are neighbours in the picture, and the outline between two of them.
//! Does not own whether that outline can be a lane (see `road::judge`).

use crate::road::fit::LaneCue;
use nalgebra::Vector2;
use verge::units::Direction;

/// Two lines that run side by side for less than this part of the shorter one are none.
const MIN_SHARED: f64 = 0.25;

/// The road between two neighbouring lines.
#[derive(Clone, Debug, PartialEq)]
pub struct Strip {
    /// The ids of its lines, from left to right in the picture.
    pub lines: [u32; 2],
    /// Its line to the left, from near to far, px.
    pub left: Vec<Vector2<f64>>,
    /// Its line to the right, from near to far, px.
    pub right: Vec<Vector2<f64>>,
}

impl Strip {
    /// Rows at which both lines are seen: the far and the near one, px.
    fn rows(&self) -> [f64; 2] {
        shared(&self.left, &self.right)
    }

    /// The cue of the road fit.
    pub fn cue(&self) -> LaneCue {
        LaneCue {
            name: format!("lines {} and {}", self.lines[0], self.lines[1]),
            right: self.right.clone(),
            left: self.left.clone(),
            direction: Direction::Unknown,
            steady: true,
        }
    }

    /// The outline of its near part, of which `part` (0 to 1) of the rows are kept.
    pub fn outline(&self, part: f64) -> Vec<Vector2<f64>> {
        let [far, near] = self.rows();
        let far = near + (far - near) * part;
        let mut outline = cut(&self.left, far, near);
        outline.extend(cut(&self.right, far, near).into_iter().rev());
        outline
    }
}

/// The lanes between neighbours of the lines, each by its id and its points (px), from left to
/// right; pairs in `apart` have none.
pub fn strips<'a>(
    lines: impl IntoIterator<Item = (u32, &'a [[f64; 2]])>,
    apart: &[[u32; 2]],
) -> Vec<Strip> {
    let lines: Vec<(u32, Vec<Vector2<f64>>)> = lines
        .into_iter()
        .filter(|(_, points)| points.len() >= 2)
        .map(|(id, points)| (id, near_to_far(points.iter().map(|&p| p.into()).collect())))
        .collect();
    let mut found = Vec::new();
    for (i, (a, left)) in lines.iter().enumerate() {
        for (j, (b, right)) in lines.iter().enumerate() {
            let [far, near] = shared(left, right);
            let shorter = height(left).min(height(right));
            if i == j || near - far < MIN_SHARED * shorter.max(1.0) {
                continue;
            }
            let row = 0.5 * (far + near);
            let (Some(from), Some(to)) = (at_row(left, row), at_row(right, row)) else { continue };
            let between = |(_, line): &(u32, Vec<Vector2<f64>>)| {
                at_row(line, row).is_some_and(|u| u > from && u < to)
            };
            let said = apart.iter().any(|p| *p == [*a, *b] || *p == [*b, *a]);
            if from < to && !said && !lines.iter().any(between) {
                let (left, right) = (left.clone(), right.clone());
                found.push((from, Strip { lines: [*a, *b], left, right }));
            }
        }
    }
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    found.into_iter().map(|(_, strip)| strip).collect()
}

fn near_to_far(mut line: Vec<Vector2<f64>>) -> Vec<Vector2<f64>> {
    if line.first().zip(line.last()).is_some_and(|(a, b)| a.y < b.y) {
        line.reverse();
    }
    line
}

fn height(line: &[Vector2<f64>]) -> f64 {
    line[0].y - line[line.len() - 1].y
}

fn shared(a: &[Vector2<f64>], b: &[Vector2<f64>]) -> [f64; 2] {
    let far = a[a.len() - 1].y.max(b[b.len() - 1].y);
    [far, a[0].y.min(b[0].y)]
}

/// Where a line crosses a row, px.
fn at_row(line: &[Vector2<f64>], row: f64) -> Option<f64> {
    line.windows(2).find_map(|w| {
        let (near, far) = (w[0], w[1]);
        let inside = row <= near.y.max(far.y) && row >= near.y.min(far.y);
        let t = (row - near.y) / (far.y - near.y);
        (inside && t.is_finite()).then(|| near.x + (far.x - near.x) * t)
    })
}

/// The part of a line between two rows.
fn cut(line: &[Vector2<f64>], far: f64, near: f64) -> Vec<Vector2<f64>> {
    let end = |row: f64| at_row(line, row).map(|u| Vector2::new(u, row));
    let inner = line.iter().copied().filter(|p| p.y < near - 0.5 && p.y > far + 0.5);
    end(near).into_iter().chain(inner).chain(end(far)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    type Line = (u32, Vec<[f64; 2]>);

    fn line(id: u32, near: f64, far: f64) -> Line {
        (id, vec![[near, 200.0], [0.5 * (near + far), 150.0], [far, 100.0]])
    }

    fn strips(lines: &[Line], apart: &[[u32; 2]]) -> Vec<Strip> {
        super::strips(lines.iter().map(|(id, points)| (*id, &points[..])), apart)
    }

    #[test]
    fn neighbours_make_lanes_whichever_way_they_were_drawn() {
        let mut lines = [line(7, 300.0, 170.0), line(2, 20.0, 140.0), line(4, 160.0, 155.0)];
        lines[1].1.reverse();
        let found = strips(&lines, &[]);
        let ids: Vec<_> = found.iter().map(|s| s.lines).collect();
        assert_eq!(ids, [[2, 4], [4, 7]]);
        let outline = found[0].outline(0.5);
        assert_eq!(outline[0], Vector2::new(20.0, 200.0));
        assert!(outline.iter().all(|p| p.y >= 150.0 - 1e-9) && outline.len() == 4);
        let ids: Vec<_> = strips(&lines, &[[4, 2]]).iter().map(|s| s.lines).collect();
        assert_eq!(ids, [[4, 7]]);
    }

    #[test]
    fn lines_one_behind_the_other_are_no_lane() {
        let near = (1, vec![[50.0, 200.0], [60.0, 150.0]]);
        let far = (2, vec![[100.0, 149.0], [100.0, 110.0]]);
        assert!(strips(&[near, far], &[]).is_empty());
    }
}
