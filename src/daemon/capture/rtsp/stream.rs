//! Properties of a video stream, and their description.

use std::time::{Duration, Instant};

/// Properties of a stream, as far as they are known.
#[derive(Clone, Debug, Default)]
pub struct Stream {
    /// Its codec and profile.
    pub codec: String,
    /// Columns and rows, px, where they are known before decoding.
    pub size: Option<(u32, u32)>,
    /// How the camera asks for a login.
    pub login: &'static str,
    /// Whole pictures, and the key pictures among them.
    pub pictures: u64,
    /// See [`Self::pictures`].
    pub keys: u64,
    /// Beginning of the counts.
    pub since: Option<Instant>,
    /// Time of the latest key picture.
    pub last_key: Option<Instant>,
    /// Time between the latest two.
    pub key_interval: Option<Duration>,
    /// Packets that are missing, and pictures that were refused.
    pub lost: u64,
    /// See [`Self::lost`].
    pub refused: u64,
}

impl Stream {
    /// Pictures a second so far.
    pub fn rate(&self) -> Option<f64> {
        let seconds = self.since?.elapsed().as_secs_f64();
        (seconds >= 1.0 && self.pictures > 1).then(|| self.pictures as f64 / seconds)
    }

    /// The stream in words, and what to set where it does not fit the interval.
    pub fn describe(&self, interval: Option<Duration>) -> String {
        let mut text = self.codec.clone();
        if let Some((width, height)) = self.size {
            text.push_str(&format!(", {width}x{height} px"));
        }
        if let Some(rate) = self.rate() {
            text.push_str(&format!(", {rate:.1} pictures/s"));
        }
        if let Some(key) = self.key_interval {
            text.push_str(&format!(", a key picture each {:.1} s", key.as_secs_f64()));
            if let Some(interval) = interval.filter(|interval| key > interval.mul_f64(1.2)) {
                text.push_str(&format!(
                    "; they are asked for each {} s: set the camera's key (I-frame) interval to that, or \
                     camera.interval_s = {:.0}",
                    interval.as_secs_f64(),
                    key.as_secs_f64().ceil()
                ));
            }
        }
        text + ", " + self.login
    }
}
