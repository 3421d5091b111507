//! The range of every key of a scene, each refused with its key, value and what may stand there.
//!
//! Owns no defaults and no file reading.

use super::Scene;
use crate::error::{Error, Result};

/// The longest road a scene may have, m: keeps sampling and traffic bounded.
const MAX_ROAD_M: f64 = 5_000.0;

/// The longest mean run of trucks: more than any measured stretch holds.
const LONGEST_RUN: f64 = 50.0;

pub(super) struct Checker<'a> {
    origin: &'a str,
}

impl Checker<'_> {
    pub(super) fn refuse(&self, key: &str, value: impl ToString, expected: impl ToString) -> Error {
        Error::SceneValue {
            origin: self.origin.to_owned(),
            key: key.to_owned(),
            value: value.to_string(),
            expected: expected.to_string(),
        }
    }

    pub(super) fn within(&self, key: &str, value: f64, low: f64, high: f64) -> Result<()> {
        if value.is_finite() && (low..=high).contains(&value) {
            return Ok(());
        }
        Err(self.refuse(key, value, format!("a number from {low} to {high}")))
    }
}

impl Scene {
    /// Refuses the first value that is out of range.
    ///
    /// # Errors
    /// [`Error::SceneValue`] with key, value and range.
    pub fn check(&self, origin: &str) -> Result<()> {
        let c = Checker { origin };
        let plain = |name: &str| {
            !name.is_empty()
                && name.bytes().all(|b| b.is_ascii_alphanumeric() || b"-_.".contains(&b))
        };
        if !plain(&self.name) {
            return Err(c.refuse("name", &self.name, "letters, digits, '-', '_' and '.'"));
        }
        if self.start_time().is_none() {
            return Err(c.refuse("start", &self.start, "a UTC time such as 2026-01-05T08:00:00Z"));
        }
        c.within("interval_s", self.interval_s, 0.01, 3600.0)?;
        c.within("warmup_s", self.warmup_s, 0.0, 7200.0)?;
        self.check_camera(&c)?;
        self.check_light(&c)?;
        self.check_road(&c)?;
        self.check_lanes(&c)?;
        self.check_fleet(&c)?;
        self.check_marks(&c)?;
        self.check_faults(&c)
    }

    fn check_camera(&self, c: &Checker) -> Result<()> {
        let camera = &self.camera;
        c.within("camera.width", f64::from(camera.width), 32.0, 4096.0)?;
        c.within("camera.height", f64::from(camera.height), 32.0, 4096.0)?;
        c.within("camera.focal_px", camera.focal_px, 20.0, 50_000.0)?;
        c.within("camera.height_m", camera.height_m, 2.0, 200.0)?;
        c.within("camera.tilt_deg", camera.tilt_deg, 1.0, 89.0)?;
        c.within("camera.pan_deg", camera.pan_deg, -180.0, 180.0)?;
        c.within("camera.roll_deg", camera.roll_deg, -45.0, 45.0)?;
        // 1 + 3 k1 r^2 > 0 up to the corner, or a point would be seen twice.
        let (half_w, half_h) = (f64::from(camera.width) / 2.0, f64::from(camera.height) / 2.0);
        let corner = half_w.hypot(half_h) / camera.focal_px;
        let lowest = -0.8 / (3.0 * (1.3 * corner).powi(2));
        c.within("camera.k1", camera.k1, lowest, 2.0)?;
        let imaging = &self.imaging;
        c.within("imaging.jpeg_quality", f64::from(imaging.jpeg_quality), 1.0, 100.0)?;
        c.within("imaging.noise_levels", imaging.noise_levels, 0.0, 50.0)?;
        c.within("imaging.blur_px", imaging.blur_px, 0.0, 5.0)?;
        c.within("imaging.sharpening", imaging.sharpening, 0.0, 3.0)?;
        c.within("imaging.chroma_smear_px", imaging.chroma_smear_px, 0.0, 8.0)?;
        c.within("imaging.supersampling", f64::from(imaging.supersampling), 0.0, 4.0)?;
        c.within("measure.min_car_height_px", self.measure.min_car_height_px, 1.0, 500.0)?;
        c.within("measure.far_m", self.measure.far_m, 1.0, MAX_ROAD_M)?;
        c.within("measure.edge_margin_px", self.measure.edge_margin_px, 0.0, 100.0)
    }

    fn check_light(&self, c: &Checker) -> Result<()> {
        c.within("light.cloud", self.light.cloud, 0.0, 1.0)?;
        c.within("light.sun_azimuth_deg", self.light.sun_azimuth_deg, -360.0, 360.0)?;
        c.within("light.sun_elevation_deg", self.light.sun_elevation_deg, 5.0, 90.0)?;
        c.within("light.rain", self.light.rain, 0.0, 1.0)
    }

    fn check_road(&self, c: &Checker) -> Result<()> {
        let road = &self.road;
        if road.pieces.is_empty() {
            return Err(c.refuse("road.piece", "[]", "at least one piece"));
        }
        for (i, piece) in road.pieces.iter().enumerate() {
            c.within(&format!("road.piece.{}.length_m", i + 1), piece.length_m, 1.0, MAX_ROAD_M)?;
            for curvature in [Some(piece.curvature_per_m), piece.end_curvature_per_m] {
                let key = format!("road.piece.{}.curvature_per_m", i + 1);
                c.within(&key, curvature.unwrap_or(0.0), -0.03, 0.03)?;
            }
        }
        let total: f64 = road.pieces.iter().map(|piece| piece.length_m).sum();
        c.within("road.piece.length_m (sum)", total, 20.0, MAX_ROAD_M)?;
        c.within("road.start_x_m", road.start_x_m, -1000.0, 1000.0)?;
        c.within("road.start_y_m", road.start_y_m, -1000.0, 1000.0)?;
        c.within("road.heading_deg", road.heading_deg, -180.0, 180.0)?;
        c.within("road.left_edge_m", road.left_edge_m, -30.0, 30.0)?;
        c.within("road.right_edge_m", road.right_edge_m, road.left_edge_m + 2.0, 30.0)?;
        c.within("road.asphalt", road.asphalt, 0.02, 0.8)?;
        for (i, marking) in self.markings.iter().enumerate() {
            c.within(&format!("marking.{}.offset_m", i + 1), marking.offset_m, -30.0, 30.0)?;
            c.within(&format!("marking.{}.width_m", i + 1), marking.width_m, 0.02, 1.0)?;
            c.within(
                &format!("marking.{}.dash_m", i + 1),
                marking.dash_m.unwrap_or(1.0),
                0.1,
                50.0,
            )?;
            c.within(&format!("marking.{}.gap_m", i + 1), marking.gap_m, 0.0, 50.0)?;
        }
        let side = &self.roadside;
        for (i, row) in side.trees.iter().enumerate() {
            c.within(&format!("roadside.trees.{}.spacing_m", i + 1), row.spacing_m, 1.0, 500.0)?;
            c.within(&format!("roadside.trees.{}.height_m", i + 1), row.height_m, 1.0, 40.0)?;
        }
        for (i, row) in side.lamps.iter().enumerate() {
            c.within(&format!("roadside.lamps.{}.spacing_m", i + 1), row.spacing_m, 2.0, 500.0)?;
        }
        for (i, barrier) in side.barriers.iter().enumerate() {
            c.within(&format!("roadside.barrier.{}.height_m", i + 1), barrier.height_m, 0.05, 6.0)?;
            c.within(&format!("roadside.barrier.{}.width_m", i + 1), barrier.width_m, 0.05, 5.0)?;
        }
        Ok(())
    }

    fn check_lanes(&self, c: &Checker) -> Result<()> {
        if !(1..=8).contains(&self.lanes.len()) {
            return Err(c.refuse("lane", self.lanes.len(), "1 to 8 lanes"));
        }
        let road_m: f64 = self.road.pieces.iter().map(|piece| piece.length_m).sum();
        for (i, lane) in self.lanes.iter().enumerate() {
            let key = |name: &str| format!("lane.{}.{name}", i + 1);
            let (left, right) = (self.road.left_edge_m, self.road.right_edge_m);
            c.within(&key("offset_m"), lane.offset_m, left, right)?;
            c.within(&key("width_m"), lane.width_m, 2.0, 8.0)?;
            c.within(&key("inflow_veh_h"), lane.inflow_veh_h, 0.0, 3000.0)?;
            c.within(&key("speed_km_h"), lane.speed_km_h, 5.0, 160.0)?;
            if let Some(signal) = lane.signal {
                c.within(&key("signal.at_m"), signal.at_m, 0.0, road_m)?;
                c.within(&key("signal.green_s"), signal.green_s, 1.0, 3600.0)?;
                c.within(&key("signal.red_s"), signal.red_s, 1.0, 3600.0)?;
                c.within(&key("signal.offset_s"), signal.offset_s, -3600.0, 3600.0)?;
            }
            if let Some(slow) = lane.slowdown {
                c.within(&key("slowdown.from_m"), slow.from_m, 0.0, road_m)?;
                c.within(&key("slowdown.to_m"), slow.to_m, slow.from_m, road_m)?;
                c.within(&key("slowdown.speed_km_h"), slow.speed_km_h, 1.0, 160.0)?;
                let period = slow.period_s.unwrap_or(3600.0);
                c.within(&key("slowdown.period_s"), period, 1.0, 3600.0)?;
                c.within(&key("slowdown.active_s"), slow.active_s, 0.0, period)?;
            }
        }
        Ok(())
    }

    fn check_fleet(&self, c: &Checker) -> Result<()> {
        let mix = &self.fleet;
        let shares = [
            ("fleet.car", mix.car),
            ("fleet.van", mix.van),
            ("fleet.bus", mix.bus),
            ("fleet.truck", mix.truck),
            ("fleet.motorcycle", mix.motorcycle),
        ];
        for (key, share) in shares {
            c.within(key, share, 0.0, 1e6)?;
        }
        c.within("fleet.taxi_share", mix.taxi_share, 0.0, 1.0)?;
        let sum: f64 = shares.iter().map(|(_, share)| share).sum();
        if sum <= 0.0 {
            return Err(c.refuse("fleet", sum, "at least one share above 0"));
        }
        c.within("fleet.trailer_share", mix.trailer_share, 0.0, 1.0)?;
        c.within("fleet.truck_run", mix.truck_run, 1.0, LONGEST_RUN)?;
        if mix.truck_run > 1.0 && mix.truck_share() >= 1.0 {
            return Err(c.refuse("fleet.truck_run", mix.truck_run, "1 in a fleet of trucks alone"));
        }
        Ok(())
    }

    fn check_faults(&self, c: &Checker) -> Result<()> {
        let faults = &self.faults;
        c.within("faults.shake_px", faults.shake_px, 0.0, 20.0)?;
        let times = [
            ("faults.frozen_from_s", faults.frozen_from_s),
            ("faults.black_from_s", faults.black_from_s),
            ("faults.until_s", faults.until_s),
        ];
        for (key, time) in times {
            c.within(key, time.unwrap_or(0.0), 0.0, 1e7)?;
        }
        if let Some(ptz) = faults.ptz {
            c.within("faults.ptz.at_s", ptz.at_s, 0.0, 1e7)?;
            c.within("faults.ptz.pan_deg", ptz.pan_deg, -90.0, 90.0)?;
            c.within("faults.ptz.tilt_deg", ptz.tilt_deg, -60.0, 60.0)?;
            c.within("faults.ptz.roll_deg", ptz.roll_deg, -45.0, 45.0)?;
            c.within("faults.ptz.until_s", ptz.until_s.unwrap_or(ptz.at_s), ptz.at_s, 1e7)?;
            c.within("faults.ptz.zoom", ptz.zoom, 0.2, 5.0)?;
        }
        Ok(())
    }
}
