//! The ranges of the keys for marks: painted words and symbols, overlays, closures, shadows.
//!
//! Owns no defaults and no file reading; the other keys are `check.rs`.

use super::check::Checker;
use super::{ClosureKind, OverlayKind, PaintedKind, Scene, ShadowKind};
use crate::error::Result;
use crate::font;

/// Longest text of a mark, characters: wider than any lane and picture.
const LONGEST_TEXT: usize = 40;

/// Most painted marks, overlays, closures and shadows of a scene, each: every sample of the ground
/// asks all of them.
const MOST_MARKS: usize = 64;

/// Nothing stands nearer than this to the middle of a lane that has traffic, m: half a bus and
/// how far from the middle it drives.
const CLEAR_M: f64 = 1.5;

impl Scene {
    pub(super) fn check_marks(&self, c: &Checker) -> Result<()> {
        let side = &self.roadside;
        for (key, count) in [
            ("painted", self.painted.len()),
            ("overlay", self.overlays.len()),
            ("roadside.closure", side.closures.len()),
            ("roadside.shadow", side.shadows.len()),
        ] {
            if count > MOST_MARKS {
                let most = format!("at most {MOST_MARKS} entries");
                return Err(c.refuse(key, format!("{count} entries"), most));
            }
        }
        self.check_painted(c)?;
        self.check_overlays(c)?;
        self.check_closures(c)?;
        self.check_shadows(c)
    }

    fn road_m(&self) -> f64 {
        self.road.pieces.iter().map(|piece| piece.length_m).sum()
    }

    fn check_painted(&self, c: &Checker) -> Result<()> {
        for (i, mark) in self.painted.iter().enumerate() {
            let key = |name: &str| format!("painted.{}.{name}", i + 1);
            c.within(&key("at_m"), mark.at_m, 0.0, self.road_m())?;
            match (mark.lane, mark.offset_m) {
                (Some(lane), None) if (1..=self.lanes.len()).contains(&lane) => {}
                (Some(lane), None) => {
                    let lanes = format!("a lane from 1 to {}", self.lanes.len());
                    return Err(c.refuse(&key("lane"), lane, lanes));
                }
                (None, Some(offset)) => c.within(
                    &key("offset_m"),
                    offset,
                    self.road.left_edge_m,
                    self.road.right_edge_m,
                )?,
                (lane, _) => {
                    let given = if lane.is_some() { "lane and offset_m" } else { "nothing" };
                    return Err(c.refuse(&key("lane"), given, "either lane or offset_m"));
                }
            }
            c.within(&key("length_m"), mark.length_m.unwrap_or(1.0), 0.1, 100.0)?;
            c.within(&key("width_m"), mark.width_m.unwrap_or(1.0), 0.1, 60.0)?;
            c.within(&key("worn"), mark.worn, 0.0, 1.0)?;
            if mark.kind == PaintedKind::Word {
                let drawn = |b: char| font::DRAWN.contains(b.to_ascii_uppercase());
                let words = || mark.text.split(' ');
                let good = mark.text.len() <= LONGEST_TEXT
                    && words().all(|word| !word.is_empty() && word.chars().all(drawn));
                if !good {
                    let expected = format!(
                        "words of {}, one space between them, at most {LONGEST_TEXT} characters",
                        font::DRAWN
                    );
                    return Err(c.refuse(&key("text"), format!("'{}'", mark.text), expected));
                }
            } else if !mark.text.is_empty() {
                return Err(c.refuse(&key("text"), &mark.text, "text with kind = \"word\" only"));
            }
        }
        Ok(())
    }

    fn check_overlays(&self, c: &Checker) -> Result<()> {
        for (i, overlay) in self.overlays.iter().enumerate() {
            let key = |name: &str| format!("overlay.{}.{name}", i + 1);
            c.within(&key("x"), overlay.x, 0.0, 1.0)?;
            c.within(&key("y"), overlay.y, 0.0, 1.0)?;
            c.within(&key("size_px"), overlay.size_px, 2.0, f64::from(self.camera.height))?;
            c.within(&key("width"), overlay.width, 0.0, 1.0)?;
            c.within(&key("turn_deg"), overlay.turn_deg, -360.0, 360.0)?;
            c.within(&key("opacity"), overlay.opacity, 0.0, 1.0)?;
            let drawn = |b: char| b == ' ' || font::DRAWN.contains(b.to_ascii_uppercase());
            let plain = overlay.text.replace("{time}", "");
            let text = overlay.kind == OverlayKind::Text;
            if text && (overlay.text.is_empty() || plain.len() > LONGEST_TEXT)
                || !plain.chars().all(drawn)
            {
                let expected = format!(
                    "{{time}}, spaces and characters of {}, 1 to {LONGEST_TEXT} of them",
                    font::DRAWN
                );
                return Err(c.refuse(&key("text"), format!("'{}'", overlay.text), expected));
            }
            if !text && !overlay.text.is_empty() {
                return Err(c.refuse(
                    &key("text"),
                    &overlay.text,
                    "text with kind = \"text\" only",
                ));
            }
        }
        Ok(())
    }

    fn check_closures(&self, c: &Checker) -> Result<()> {
        for (i, closure) in self.roadside.closures.iter().enumerate() {
            let key = |name: &str| format!("roadside.closure.{}.{name}", i + 1);
            c.within(&key("from_m"), closure.from_m, 0.0, self.road_m())?;
            c.within(&key("to_m"), closure.to_m, closure.from_m, self.road_m())?;
            c.within(&key("offset_m"), closure.offset_m, -30.0, 30.0)?;
            let end = closure.to_offset_m.unwrap_or(closure.offset_m);
            c.within(&key("to_offset_m"), end, -30.0, 30.0)?;
            let least = if closure.kind == ClosureKind::Cone { 0.5 } else { 0.0 };
            c.within(&key("gap_m"), closure.gap_m.unwrap_or(least), least, 100.0)?;
            let (left, right) = (closure.offset_m.min(end), closure.offset_m.max(end));
            let half = closure.kind.width_m() / 2.0;
            for (number, lane) in self.lanes.iter().enumerate() {
                let near = lane.offset_m.clamp(left, right);
                if lane.inflow_veh_h > 0.0 && (near - lane.offset_m).abs() < CLEAR_M + half {
                    let expected = format!(
                        "a place at least {:.2} m from the middle of lane {}, which has traffic",
                        CLEAR_M + half,
                        number + 1
                    );
                    return Err(c.refuse(&key("offset_m"), closure.offset_m, expected));
                }
            }
        }
        Ok(())
    }

    fn check_shadows(&self, c: &Checker) -> Result<()> {
        for (i, shadow) in self.roadside.shadows.iter().enumerate() {
            let key = |name: &str| format!("roadside.shadow.{}.{name}", i + 1);
            c.within(&key("at_m"), shadow.at_m, -200.0, self.road_m() + 200.0)?;
            c.within(&key("offset_m"), shadow.offset_m, -100.0, 100.0)?;
            let end = shadow.to_offset_m.unwrap_or(shadow.offset_m);
            c.within(&key("to_offset_m"), end, -100.0, 100.0)?;
            if shadow.kind != ShadowKind::Gantry && shadow.to_offset_m.is_some() {
                let expected = "to_offset_m with kind = \"gantry\" only";
                return Err(c.refuse(&key("to_offset_m"), end, expected));
            }
            c.within(&key("height_m"), shadow.height_m, 1.0, 100.0)?;
            c.within(&key("width_m"), shadow.width_m.unwrap_or(1.0), 0.02, 30.0)?;
        }
        Ok(())
    }
}
