//! A recording from its first frame to its last, through a line or a detector.
//!
//! Owns what happens to frames that cannot be used: they are said, counted as missed, and
//! only a recording of which nothing could be used is an error.

use crate::daemon::capture::{Captured, Recorded, Source};
use crate::daemon::exit::Failure;
use crate::daemon::frame::{Detection, Frame, Picture};
use crate::daemon::line::Line;
use crate::density::{Closed, SampleZoneStatus};
use crate::health::Event;
use crate::lane::Description;

/// Plays a recording through a line: each frame that was measured, and the windows as
/// they close. Frames that cannot be measured are said and count as missed.
pub fn play(
    recorded: Recorded,
    line: &mut Line,
    mut on_frame: impl FnMut(&Frame, &[Detection]) -> Result<(), Failure>,
    mut on_windows: impl FnMut(&Closed, &Description) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let mut player = Player::new(recorded);
    while let Some(captured) = player.next() {
        let outcome = captured.and_then(|()| line.measure(&player.frame));
        let closed = match outcome {
            Ok(measured) => {
                player.judged(measured.event);
                on_frame(&player.frame, line.found())?;
                measured.closed
            }
            Err(fault) => {
                player.note(&fault);
                line.miss(player.frame.time, SampleZoneStatus::InputDataIntegrity)
            }
        };
        on_windows(&closed, line.reported())?;
    }
    player.finish()?;
    let closed = line.finish();
    on_windows(&closed, line.reported())
}

/// Searches a recording for vehicles. Frames that cannot be searched are said.
pub fn search(
    recorded: Recorded,
    mut detect: impl FnMut(&Picture, &mut Vec<Detection>) -> Result<(), Failure>,
    mut on_frame: impl FnMut(&Frame, &[Detection]) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let mut player = Player::new(recorded);
    let mut found = Vec::new();
    while let Some(captured) = player.next() {
        match captured.and_then(|()| detect(&player.frame.picture, &mut found)) {
            Ok(()) => {
                player.measured += 1;
                on_frame(&player.frame, &found)?;
            }
            Err(fault) => player.note(&fault),
        }
    }
    player.finish()
}

/// A recording as it is played, and how that goes.
struct Player {
    source: Source,
    frame: Frame,
    frames: usize,
    measured: usize,
    first_fault: Option<String>,
    /// What the latest frame was.
    event: Event,
}

impl Player {
    fn new(recorded: Recorded) -> Self {
        let frames = recorded.frames();
        let source = Source::Recorded(recorded);
        Self {
            source,
            frame: Frame::default(),
            frames,
            measured: 0,
            first_fault: None,
            event: Event::Measured,
        }
    }

    /// Fills `frame` with the next picture; `None` at the end.
    fn next(&mut self) -> Option<Result<(), Failure>> {
        match self.source.next(&mut self.frame) {
            Ok(Captured::End) => None,
            Ok(Captured::New | Captured::Unchanged) => Some(Ok(())),
            Err(fault) => Some(Err(fault.into())),
        }
    }

    /// Says what a frame was when that changes.
    fn judged(&mut self, event: Event) {
        self.measured += 1;
        let name = &self.frame.name;
        if event != self.event {
            match event {
                Event::Withheld(alarm) => log::warn!("from frame {name} on: {}", alarm.name()),
                Event::Unchanged => log::warn!("frame {name} shows nothing new"),
                Event::PassedOver => log::warn!("frame {name} is displaced"),
                _ => log::info!("from frame {name} on all is well"),
            }
        }
        self.event = event;
    }

    fn note(&mut self, fault: &Failure) {
        let fault = fault.to_string();
        log::warn!("frame {} is left out: {fault}", self.frame.name);
        self.first_fault.get_or_insert(fault);
    }

    /// A recording of which nothing could be measured is an error.
    fn finish(self) -> Result<(), Failure> {
        match self.first_fault {
            Some(first) if self.measured == 0 => {
                Err(Failure::NothingMeasured { frames: self.frames, first })
            }
            _ => Ok(()),
        }
    }
}
