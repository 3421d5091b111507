//! One lane: arrivals, car following, the signal and the slow stretch.
//!
//! Owns the vehicles of a lane, front-most first, in metres along the direction of travel.
//! Takes time as an argument; integrates with the ballistic scheme (Treiber and Kesting 2013,
//! eq. 10.8). Owns no geometry in the plane.

use std::collections::VecDeque;

use super::fleet::{Fleet, Vehicle};
use crate::road::Direction;
use crate::scene::{LaneSpec, Signal, Slowdown};

/// Vehicles that wait outside a lane that is full at its upstream end, at most: the demand
/// beyond is dropped, as it would have chosen another road.
const WAITING_CAPACITY: usize = 8;

/// A driver passes a signal that turns red when stopping would need more than this, m/s^2.
const STOPPABLE_M_S2: f64 = 3.0;

/// A vehicle is set on the road only with this multiple of its equilibrium gap ahead.
const ENTRY_GAP: f64 = 1.0;

/// Traffic of one lane.
#[derive(Debug, Clone)]
pub struct LaneTraffic {
    spec: LaneSpec,
    length_m: f64,
    fleet: Fleet,
    vehicles: VecDeque<Vehicle>,
    waiting: VecDeque<Vehicle>,
    next_arrival_s: f64,
    departed: u64,
    dropped: u64,
}

impl LaneTraffic {
    /// An empty lane `length_m` long whose first arrival comes at or after `now_s`.
    pub fn new(spec: LaneSpec, length_m: f64, mut fleet: Fleet, now_s: f64) -> Self {
        let next_arrival_s = if spec.inflow_veh_h > 0.0 {
            now_s + fleet.next_headway_s(spec.inflow_veh_h)
        } else {
            f64::INFINITY
        };
        LaneTraffic {
            spec,
            length_m,
            fleet,
            vehicles: VecDeque::new(),
            waiting: VecDeque::new(),
            next_arrival_s,
            departed: 0,
            dropped: 0,
        }
    }

    /// The vehicles, the one farthest downstream first.
    pub fn vehicles(&self) -> impl Iterator<Item = &Vehicle> {
        self.vehicles.iter()
    }

    /// Vehicles that have left the downstream end so far.
    pub fn departed(&self) -> u64 {
        self.departed
    }

    /// Arrivals dropped so far because the lane and its waiting room were full.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }

    /// Length of the lane, m.
    pub fn length_m(&self) -> f64 {
        self.length_m
    }

    /// Distance along the lane from the road's start of a place in travel order, m.
    pub fn lane_s(&self, travelled_m: f64) -> f64 {
        match self.spec.direction {
            Direction::Away => travelled_m,
            Direction::Toward => self.length_m - travelled_m,
        }
    }

    /// True when the lane has a signal and it shows red.
    pub fn is_red(&self, now_s: f64) -> bool {
        self.spec.signal.is_some_and(|signal| red_at(&signal, now_s))
    }

    /// Moves the lane from `now_s` by `dt_s`. New vehicles take ids from `next_id`.
    pub fn step(&mut self, now_s: f64, dt_s: f64, next_id: &mut u64) {
        self.arrive(now_s, next_id);
        self.accelerate(now_s);
        self.advance(dt_s);
        while self
            .vehicles
            .front()
            .is_some_and(|v| v.front_m - v.model().length_m() > self.length_m)
        {
            self.vehicles.pop_front();
            self.departed += 1;
        }
    }

    fn arrive(&mut self, now_s: f64, next_id: &mut u64) {
        while self.next_arrival_s <= now_s {
            let vehicle = self.fleet.draw(*next_id);
            *next_id += 1;
            if self.waiting.len() < WAITING_CAPACITY {
                self.waiting.push_back(vehicle);
            } else {
                self.dropped += 1;
            }
            self.next_arrival_s += self.fleet.next_headway_s(self.spec.inflow_veh_h);
        }
        let Some(mut vehicle) = self.waiting.pop_front() else { return };
        let speed = vehicle.driver.idm.desired_speed_m_s;
        match self.vehicles.back() {
            None => vehicle.speed_m_s = speed,
            Some(last) => {
                let gap = last.front_m - last.model().length_m();
                vehicle.speed_m_s = speed.min(last.speed_m_s);
                let needed =
                    vehicle.driver.idm.equilibrium_gap_m(vehicle.speed_m_s.min(0.9 * speed));
                if gap < ENTRY_GAP * needed {
                    self.waiting.push_front(vehicle);
                    return;
                }
            }
        }
        self.vehicles.push_back(vehicle);
    }

    fn accelerate(&mut self, now_s: f64) {
        let stop = self.spec.signal.filter(|s| red_at(s, now_s)).map(|s| self.travelled(s.at_m));
        let slow = self.spec.slowdown.filter(|s| slow_at(s, now_s));
        let mut leader: Option<(f64, f64)> = None;
        for i in 0..self.vehicles.len() {
            let vehicle = &self.vehicles[i];
            let (front, speed) = (vehicle.front_m, vehicle.speed_m_s);
            let idm = vehicle.driver.idm;
            let ahead = leader.map(|(rear, its_speed)| (rear - front, speed - its_speed));
            let mut acceleration = idm.acceleration(speed, ahead);
            let s = self.lane_s(front);
            if let Some(slow) = slow.filter(|slow| (slow.from_m..=slow.to_m).contains(&s)) {
                let mut slowed = idm;
                slowed.desired_speed_m_s = idm.desired_speed_m_s.min(slow.speed_km_h / 3.6);
                // Drivers come down to the lower speed in comfort.
                let ease = slowed.acceleration(speed, None).max(-idm.deceleration_m_s2);
                acceleration = acceleration.min(ease);
            }
            if let Some(line) = stop.filter(|line| *line >= front) {
                let room = (line - front).max(0.01);
                if speed * speed / (2.0 * room) <= STOPPABLE_M_S2 {
                    acceleration = acceleration.min(idm.acceleration(speed, Some((room, speed))));
                }
            }
            leader = Some((front - self.vehicles[i].model().length_m(), speed));
            self.vehicles[i].acceleration_m_s2 = acceleration;
        }
    }

    fn advance(&mut self, dt_s: f64) {
        for vehicle in &mut self.vehicles {
            let (speed, a) = (vehicle.speed_m_s, vehicle.acceleration_m_s2);
            let next = speed + a * dt_s;
            if next < 0.0 {
                // Comes to a stand within the step.
                vehicle.front_m += speed * speed / (2.0 * -a);
                vehicle.speed_m_s = 0.0;
            } else {
                vehicle.front_m += (speed + next) / 2.0 * dt_s;
                vehicle.speed_m_s = next;
            }
        }
    }

    /// Travel coordinate of a distance along the lane; the same mapping as [`Self::lane_s`].
    fn travelled(&self, lane_s: f64) -> f64 {
        self.lane_s(lane_s)
    }
}

fn red_at(signal: &Signal, now_s: f64) -> bool {
    (now_s - signal.offset_s).rem_euclid(signal.green_s + signal.red_s) >= signal.green_s
}

fn slow_at(slow: &Slowdown, now_s: f64) -> bool {
    slow.period_s.is_none_or(|period| now_s.rem_euclid(period) < slow.active_s)
}
