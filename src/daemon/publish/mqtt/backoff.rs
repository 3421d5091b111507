//! How long to wait before the next attempt at the broker.
//!
//! Full jitter: the wait is uniform between 0 and a ceiling that doubles with each attempt,
//! so that a city of boxes does not knock at a restarted broker at once. It begins again when a
//! window has arrived, or a session has lasted a minute: a broker that only accepts connections is
//! no better than one that is away. Whatever a broker does with them, connections to it are
//! counted and bounded.

use fastrand::Rng;
use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// First and last ceiling.
const CEILING: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(60));

/// Most connections in [`SPAN`]. Up to three more may follow at once, in another version.
const MOST: usize = 9;
/// See [`MOST`].
const SPAN: Duration = Duration::from_secs(120);
/// How long a client stays away whose id another one uses, at least.
const GIVE_WAY: Duration = Duration::from_secs(30);

#[derive(Debug)]
pub(super) struct Backoff {
    ceiling: Duration,
    /// Of the next wait alone.
    floor: Duration,
    connections: VecDeque<Instant>,
}

impl Backoff {
    pub(super) const fn new() -> Self {
        Self { ceiling: CEILING.0, floor: Duration::ZERO, connections: VecDeque::new() }
    }

    /// The next wait.
    pub(super) fn wait(&mut self, random: &mut Rng, now: Instant) -> Duration {
        let wait = self.ceiling.mul_f64(random.f64()).max(std::mem::take(&mut self.floor));
        self.ceiling = (self.ceiling * 2).min(CEILING.1);
        if self.connections.len() < MOST {
            return wait;
        }
        let oldest = self.connections[self.connections.len() - MOST];
        wait.max((oldest + SPAN).saturating_duration_since(now))
    }

    /// A broker has accepted a connection, whatever it does with it.
    pub(super) fn connected(&mut self, now: Instant) {
        self.connections.push_back(now);
        if self.connections.len() > MOST {
            self.connections.pop_front();
        }
    }

    /// There is no broker: the next one has not seen us.
    pub(super) fn away(&mut self) {
        self.connections.clear();
    }

    /// A window has arrived, or a minute was quiet.
    pub(super) const fn reset(&mut self) {
        self.ceiling = CEILING.0;
    }

    /// Another client uses our id: each attempt throws it out.
    pub(super) fn give_way(&mut self) {
        (self.ceiling, self.floor) = (CEILING.1, GIVE_WAY);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Attempts per second of 1,000 boxes at a broker that was away for `outage_s`, from its
    /// return until the last of them is back, in bins of a sixtieth of that time.
    fn attempts(outage_s: f64, seed: u64) -> (Vec<f64>, f64) {
        let (mut random, now) = (Rng::with_seed(seed), Instant::now());
        let back: Vec<f64> = (0..1000)
            .map(|_| {
                let (mut backoff, mut time) = (Backoff::new(), 0.0);
                while time < outage_s {
                    time += backoff.wait(&mut random, now).as_secs_f64();
                }
                time - outage_s
            })
            .collect();
        let last = back.iter().copied().fold(0.0, f64::max);
        let bin = last / 60.0;
        let mut rates = vec![0.0; 60];
        for time in &back {
            rates[((time / bin) as usize).min(59)] += 1.0 / bin;
        }
        (rates, 1000.0 / last)
    }

    #[test]
    fn a_city_returns_at_no_more_than_twice_the_mean_rate() {
        for outage_s in [120.0, 600.0, 3600.0] {
            let runs = 200;
            let (mut sums, mut mean) = (vec![0.0; 60], 0.0);
            for seed in 0..runs {
                let (rates, run_mean) = attempts(outage_s, seed);
                sums.iter_mut().zip(rates).for_each(|(sum, rate)| *sum += rate);
                mean += run_mean;
            }
            let peak = sums.into_iter().fold(0.0, f64::max) / mean;
            println!("outage of {outage_s} s: peak {peak:.2} times the mean rate");
            assert!(peak <= 2.0, "outage of {outage_s} s: {peak}");
        }
    }

    #[test]
    fn waits_grow_to_a_minute_and_begin_again() {
        let mut random = Rng::with_seed(1);
        let mut backoff = Backoff::new();
        for ceiling in [1, 2, 4, 8, 16, 32, 60, 60] {
            assert_eq!(backoff.ceiling, Duration::from_secs(ceiling));
            assert!(backoff.wait(&mut random, Instant::now()) <= Duration::from_secs(ceiling));
        }
        backoff.reset();
        assert_eq!(backoff.ceiling, CEILING.0);
        backoff.give_way();
        assert!(backoff.wait(&mut random, Instant::now()) >= GIVE_WAY);
    }

    /// A broker that lets in, takes a window, and closes: the ceiling is the first each time.
    #[test]
    fn connections_are_bounded_whatever_a_broker_does() {
        for seed in 0..200 {
            let (mut random, start) = (Rng::with_seed(seed), Instant::now());
            let (mut backoff, mut time) = (Backoff::new(), Duration::ZERO);
            let mut connections = Vec::new();
            while time < Duration::from_secs(600) {
                backoff.connected(start + time);
                connections.push(time);
                backoff.reset();
                time += backoff.wait(&mut random, start + time);
            }
            for first in &connections {
                let within = connections.iter().filter(|at| (*first..*first + SPAN).contains(*at));
                assert!(within.count() <= MOST, "seed {seed}");
            }
            backoff.away();
            assert!(backoff.wait(&mut random, start + time) <= 2 * CEILING.0, "a new broker");
        }
    }
}
