//! Pictures against the references of all presets: the search and the rules in one.
//!
//! Owns the order in which presets are looked for, and what is made of a picture that shows
//! none of them.

use super::reference::Reference;
use super::search::search;
use super::watch::{Aim, Evidence, Judgement, SPACING, Watch};
use super::{Cell, Eye};
use core::time::Duration;

/// Watches where a camera looks. Holds one reference of its own (12 KB).
#[derive(Debug)]
pub struct Guard {
    watch: Watch,
    /// Another scene than the presets', and when it was seen first.
    other: Reference,
    other_since: Option<Duration>,
}

impl Guard {
    /// A camera with so many presets, none of them seen yet.
    pub fn new(presets: usize) -> Self {
        Self { watch: Watch::new(presets), other: Reference::default(), other_since: None }
    }

    /// Where the camera looks.
    pub const fn aim(&self) -> Aim {
        self.watch.aim()
    }

    /// Judges the picture that `eye` has taken at `now` (time since start).
    pub fn judge(
        &mut self,
        references: &[Reference],
        eye: &Eye<impl AsRef<[u8]>, impl AsRef<[Cell]>>,
        now: Duration,
    ) -> Judgement {
        let evidence = self.evidence(references, eye, now);
        self.watch.on(evidence, now)
    }

    fn evidence(
        &mut self,
        references: &[Reference],
        eye: &Eye<impl AsRef<[u8]>, impl AsRef<[Cell]>>,
        now: Duration,
    ) -> Evidence {
        let here = match self.watch.aim() {
            Aim::Preset(preset) => preset,
            Aim::Unknown | Aim::Moved => 0,
        };
        let mut displaced = false;
        // The present one first: nearly always it is the one.
        let numbered = || references.iter().enumerate();
        for (preset, reference) in numbered().skip(here).chain(numbered().take(here)) {
            match Evidence::of(preset, &search(reference, eye), eye.grid()) {
                found @ Evidence::InPlace { .. } => {
                    self.other_since = None;
                    return found;
                }
                Evidence::Displaced => displaced = true,
                Evidence::Elsewhere | Evidence::Unclear => {}
            }
        }
        if displaced { Evidence::Displaced } else { self.elsewhere(eye, now) }
    }

    /// No preset is seen. Where two pictures some time apart show one scene all the same, the
    /// camera looks elsewhere; where not even they agree, nothing is known.
    fn elsewhere(
        &mut self,
        eye: &Eye<impl AsRef<[u8]>, impl AsRef<[Cell]>>,
        now: Duration,
    ) -> Evidence {
        if let Some(since) = self.other_since {
            if search(&self.other, eye).is_sure() {
                let apart = now.saturating_sub(since) >= SPACING;
                return if apart { Evidence::Elsewhere } else { Evidence::Unclear };
            }
            self.other_since = None;
        }
        if let Ok(other) = Reference::of(&eye.fine(), &eye.coarse(), |_, _| false) {
            self.other = other;
            self.other_since = Some(now);
        }
        Evidence::Unclear
    }
}
