//! How long to wait before the next attempt at the broker.
//!
//! Full jitter: the wait is uniform between 0 and a ceiling that doubles with each attempt,
//! so that a city of boxes does not knock at a restarted broker at once. It begins again
//! when a broker has taken a message: one that only accepts connections is no better than
//! one that is away.

use fastrand::Rng;
use std::time::Duration;

/// First and last ceiling.
const CEILING: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(60));

#[derive(Debug)]
pub(super) struct Backoff {
    ceiling: Duration,
}

impl Backoff {
    pub(super) const fn new() -> Self {
        Self { ceiling: CEILING.0 }
    }

    /// The next wait.
    pub(super) fn wait(&mut self, random: &mut Rng) -> Duration {
        let wait = self.ceiling.mul_f64(random.f64());
        self.ceiling = (self.ceiling * 2).min(CEILING.1);
        wait
    }

    /// A broker has taken a message.
    pub(super) const fn reset(&mut self) {
        self.ceiling = CEILING.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Attempts per second of 1,000 boxes at a broker that was away for `outage_s`, from its
    /// return until the last of them is back, in bins of a sixtieth of that time.
    fn attempts(outage_s: f64, seed: u64) -> (Vec<f64>, f64) {
        let mut random = Rng::with_seed(seed);
        let back: Vec<f64> = (0..1000)
            .map(|_| {
                let (mut backoff, mut time) = (Backoff::new(), 0.0);
                while time < outage_s {
                    time += backoff.wait(&mut random).as_secs_f64();
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
            assert!(backoff.wait(&mut random) <= Duration::from_secs(ceiling));
        }
        backoff.reset();
        assert_eq!(backoff.ceiling, CEILING.0);
    }
}
