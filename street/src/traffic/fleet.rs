//! Draws the next vehicle and its driver.
//!
//! Owns the spread between drivers and the identity of vehicles. Spread of IDM parameters: our
//! choice, 5 to 20 % about the means, so that platoons form; heavy vehicles accelerate slower.

use super::idm::IdmParameters;
use crate::random::Stream;
use crate::scene::FleetMix;
use crate::vehicle::paint::Livery;
use crate::vehicle::{ARTICULATED, CAR_MODELS, Class, MODELS, Model};

/// A driver: the model's parameters and where in the lane they keep.
#[derive(Debug, Clone, Copy)]
pub struct Driver {
    /// Car-following parameters.
    pub idm: IdmParameters,
    /// Distance kept right of the lane's centre, m.
    pub aside_m: f64,
}

/// One vehicle in traffic.
#[derive(Debug, Clone)]
pub struct Vehicle {
    /// Unique in the recording, from 1.
    pub id: u64,
    /// Index into [`MODELS`].
    pub model_index: usize,
    /// Its driver.
    pub driver: Driver,
    /// Its colours.
    pub livery: Livery,
    /// Front bumper along the direction of travel from the lane's upstream end, m.
    pub front_m: f64,
    /// Speed, m/s.
    pub speed_m_s: f64,
    /// Last acceleration, m/s^2: brake lights.
    pub acceleration_m_s2: f64,
}

impl Vehicle {
    /// Its model.
    pub fn model(&self) -> &'static Model {
        &MODELS[self.model_index]
    }
}

/// The source of vehicles of one lane.
#[derive(Debug, Clone)]
pub struct Fleet {
    mix: FleetMix,
    desired_speed_m_s: f64,
    stream: Stream,
    /// The next vehicle is a truck that follows the last one nose to tail.
    follows: bool,
    /// The last vehicle was a truck.
    after_truck: bool,
}

/// Place of trucks among the shares of the mix.
const TRUCK: usize = 3;

/// A truck follows another in a run at this share of its driver's usual gaps.
const RUN_GAP: f64 = 0.5;

/// Time from one truck's arrival to the next in a run, s.
const RUN_HEADWAY_S: f64 = 1.0;

/// Probability that a truck is the last of its run: no more than chance alone has it.
fn run_ends(mix: &FleetMix) -> f64 {
    (1.0 / mix.truck_run).min(1.0 - mix.truck_share())
}

impl Fleet {
    /// Vehicles of a mix whose drivers want the given mean speed.
    pub fn new(mix: FleetMix, desired_speed_m_s: f64, stream: Stream) -> Self {
        Fleet { mix, desired_speed_m_s, stream, follows: false, after_truck: false }
    }

    /// The next vehicle; place and speed are left at 0.
    pub fn draw(&mut self, id: u64) -> Vehicle {
        let mix = self.mix;
        let rng = &mut self.stream;
        let runs = mix.truck_run > 1.0;
        let mut weights = [mix.car, mix.van, mix.bus, mix.truck, mix.motorcycle];
        if runs {
            // The two rates of a Markov chain whose share of trucks is that of the mix.
            let share = mix.truck_share();
            let starts = share * run_ends(&mix) / (1.0 - share);
            let others = weights.iter().sum::<f64>() - mix.truck;
            weights[TRUCK] = if self.after_truck { 0.0 } else { others * starts / (1.0 - starts) };
        }
        let follows = self.follows;
        let kind = if follows { TRUCK } else { rng.weighted(&weights) };
        self.after_truck = kind == TRUCK;
        self.follows = runs && self.after_truck && rng.unit() >= run_ends(&mix);
        let model_index = match kind {
            0 => ((rng.unit() * CAR_MODELS as f64) as usize).min(CAR_MODELS - 1),
            TRUCK if mix.trailer_share > 0.0 && rng.unit() < mix.trailer_share => ARTICULATED,
            other => CAR_MODELS + other - 1,
        };
        let model = &MODELS[model_index];
        let close = if follows { RUN_GAP } else { 1.0 };
        let heavy = matches!(model.class, Class::Bus | Class::Truck);
        let idm = IdmParameters {
            desired_speed_m_s: self.desired_speed_m_s
                * rng.normal(if heavy { 0.9 } else { 1.0 }, 0.08),
            headway_s: close * rng.normal(if heavy { 1.3 } else { 1.0 }, 0.15),
            jam_gap_m: close * rng.normal(2.0, 0.35),
            acceleration_m_s2: if heavy { 0.6 } else { rng.normal(1.0, 0.12) },
            deceleration_m_s2: rng.normal(1.5, 0.15),
        };
        let wander = if model.class == Class::Motorcycle { 0.45 } else { 0.14 };
        let driver = Driver { idm, aside_m: rng.normal(0.0, wander) };
        let livery = Livery::draw(model.class, mix.taxi_share, rng);
        Vehicle {
            id,
            model_index,
            driver,
            livery,
            front_m: 0.0,
            speed_m_s: 0.0,
            acceleration_m_s2: 0.0,
        }
    }

    /// The time to the next arrival, s, at a mean flow in veh/h: a minimum headway of 1 s plus
    /// an exponential rest (shifted-exponential headways). Trucks of a run come close together, so
    /// all others farther apart.
    pub fn next_headway_s(&mut self, flow_veh_h: f64) -> f64 {
        let mut mean = 3600.0 / flow_veh_h;
        if self.follows {
            return RUN_HEADWAY_S;
        }
        if self.mix.truck_run > 1.0 {
            let close = self.mix.truck_share() * (1.0 - run_ends(&self.mix));
            mean = (mean - close * RUN_HEADWAY_S) / (1.0 - close);
        }
        let least = 1.0_f64.min(0.8 * mean);
        least + self.stream.exponential(mean - least)
    }
}
