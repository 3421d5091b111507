//! The keys of a scene for lanes, their demand and signals, and painted lines.
//!
//! Owns them as data; ranges are `check.rs`, behaviour is `traffic/`.

use serde::Deserialize;

use crate::road::Direction;

/// One lane and its demand.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LaneSpec {
    /// Centre right of the reference line, m.
    pub offset_m: f64,
    /// Width, m.
    pub width_m: f64,
    /// Way of travel.
    pub direction: Direction,
    /// Mean arrivals at the upstream end, veh/h.
    pub inflow_veh_h: f64,
    /// Desired speed of the average driver, km/h.
    pub speed_km_h: f64,
    /// Where passages and time occupancy are taken, from the upstream end of the measured stretch, m;
    /// absent is its middle.
    pub section_m: Option<f64>,
    /// A signalised stop line.
    pub signal: Option<Signal>,
    /// A stretch that slows traffic.
    pub slowdown: Option<Slowdown>,
}

/// A fixed-time signal at a stop line. Starts green.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Signal {
    /// Stop line along the lane from the road's start, m.
    pub at_m: f64,
    /// Green time, s.
    pub green_s: f64,
    /// Red time, s.
    pub red_s: f64,
    /// Start of the first green, s after the first frame (may be negative).
    #[serde(default)]
    pub offset_s: f64,
}

/// A stretch on which drivers want to go slower, all the time or in pulses.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Slowdown {
    /// Start along the lane from the road's start, m.
    pub from_m: f64,
    /// End along the lane, m.
    pub to_m: f64,
    /// Desired speed there, km/h.
    pub speed_km_h: f64,
    /// Period of the pulses, s; absent means always slow.
    pub period_s: Option<f64>,
    /// Slow part of each period, s.
    #[serde(default)]
    pub active_s: f64,
}

/// A painted line along the road.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Marking {
    /// Centre right of the reference line, m.
    pub offset_m: f64,
    /// Width, m.
    #[serde(default = "default_marking_width")]
    pub width_m: f64,
    /// Length of a dash, m; absent is a solid line.
    pub dash_m: Option<f64>,
    /// Gap between dashes, m.
    #[serde(default)]
    pub gap_m: f64,
    /// Yellow and not white.
    #[serde(default)]
    pub yellow: bool,
}

fn default_marking_width() -> f64 {
    0.12
}
