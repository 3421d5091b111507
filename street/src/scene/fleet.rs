//! The keys of a scene for its fleet.
//!
//! Owns them as data; ranges are `check.rs`, the draw is `traffic/fleet.rs`.

use serde::Deserialize;

/// Shares of vehicle classes; any scale.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FleetMix {
    /// The five car models, equally.
    pub car: f64,
    /// Vans.
    pub van: f64,
    /// Buses.
    pub bus: f64,
    /// Trucks.
    pub truck: f64,
    /// Motorcycles.
    pub motorcycle: f64,
    /// Share of cars painted as taxis, 0 to 1.
    pub taxi_share: f64,
    /// Share of trucks that pull a semi-trailer, 0 to 1.
    pub trailer_share: f64,
    /// Mean number of trucks that follow one another nose to tail; 1 is as chance has it.
    pub truck_run: f64,
}

impl FleetMix {
    /// Share of trucks among all vehicles, 0 to 1.
    pub fn truck_share(&self) -> f64 {
        self.truck / (self.car + self.van + self.bus + self.truck + self.motorcycle)
    }
}

impl Default for FleetMix {
    fn default() -> Self {
        FleetMix {
            car: 0.78,
            van: 0.1,
            bus: 0.03,
            truck: 0.06,
            motorcycle: 0.03,
            taxi_share: 0.0,
            trailer_share: 0.0,
            truck_run: 1.0,
        }
    }
}
