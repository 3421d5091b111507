//! The counting core on a microcontroller: Cortex-M4F, detections in, messages out.
//!
//! A detector beside the microcontroller writes one frame's boxes at a time into memory that both
//! see, the lane table lies in memory-mapped flash, messages leave as they came. It links `units`,
//! `lane`, `density`, `traffic`, `sensor`, `health`, `alarm`, `derate`, `fault`, `wire` and `hal`
//! inside `memory.x` (the link fails when they outgrow it) and without a single panic path.
//! Pictures are the eye core's (`eye_core.rs`). `tests/node/run` runs both and measures the stack.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
#[path = "../panic.rs"]
mod panic;
#[cfg(target_os = "none")]
#[path = "../ring.rs"]
mod ring;
#[cfg(target_os = "none")]
#[path = "../table.rs"]
mod table;

#[cfg(target_os = "none")]
mod firmware {
    use crate::ring::{Reader, Writer};
    use crate::table;
    use core::time::Duration;
    use cortex_m_rt::entry;
    use verge::density::Start;
    use verge::hal::{Board, Switch, Watchdog};
    use verge::lane::Name;
    use verge::sensor::{Action, Now, Outcome, Preset, Sensor};
    use verge::units::{ImagePoint, UtcMs, VehicleClass};
    use verge::wire::{self, DensityMessage, MAX_DENSITY_MESSAGE, ModelRef};

    /// Where frames come in, messages go out, and the lane table lies behind its length: in the
    /// board's PSRAM, which takes the part of memory on a bus.
    const INBOX_AT: usize = 0x2100_0000;
    const OUTBOX_AT: usize = 0x2110_0000;
    const TABLE_AT: usize = 0x2120_0000;
    /// Most vehicles of one frame: eight lanes of 50 m at jam density and a half more.
    const MAX_BOXES: usize = 96;
    /// Frames of two minutes.
    const FRAMES: usize = 128;
    /// One frame a second, windows of a minute.
    const INTERVAL: Duration = Duration::from_secs(1);
    const WINDOW: Duration = Duration::from_secs(60);

    /// One frame's vehicles as the detector writes them.
    #[repr(C)]
    #[derive(Clone, Copy)]
    struct Frame {
        time_ms: i64,
        since_start_ms: u32,
        count: u32,
        contacts: [ImagePoint; MAX_BOXES],
        classes: [u8; MAX_BOXES],
    }

    /// A message in the compact form.
    #[repr(C)]
    #[derive(Clone, Copy)]
    struct Message {
        len: u32,
        bytes: [u8; MAX_DENSITY_MESSAGE],
    }

    #[entry]
    fn main() -> ! {
        let mut board: Board = Board::default();
        let _ = measure(&mut board);
        // Without a table there is nothing to measure: the watchdog resets the box.
        loop {
            core::hint::spin_loop();
        }
    }

    fn measure(board: &mut Board) -> Option<core::convert::Infallible> {
        // SAFETY: the flash is mapped before reset leaves the boot loader, and never written.
        let table = unsafe { table::read(TABLE_AT) }?;
        let description = table.description();
        let preset =
            Preset::<1>::new(description, &[WINDOW], INTERVAL, 0.75, Start::AtNextWindow).ok()?;
        let nothing = preset.counts();
        let mut sensor = Sensor::<_, 1>::new([preset], INTERVAL);
        // SAFETY: the board's PSRAM, whose content is numbers alone.
        let mut inbox = unsafe { Reader::<Frame, FRAMES>::at(INBOX_AT) };
        // SAFETY: as before, and nothing else writes there.
        let mut outbox = unsafe { Writer::<Message, 1>::at(OUTBOX_AT) };
        let mut message = Message { len: 0, bytes: [0; MAX_DENSITY_MESSAGE] };
        let mut seq = 0u64;
        loop {
            let frame = inbox.next();
            let mut counts = nothing.clone();
            for (&contact, &class) in
                frame.contacts.iter().zip(&frame.classes).take(frame.count as usize)
            {
                let class = VehicleClass::ALL.get(usize::from(class)).copied();
                if let Some(place) = table.place(contact) {
                    counts.add(place.lane, place.s_m, class.unwrap_or(VehicleClass::Vehicle));
                }
            }
            let time = UtcMs(frame.time_ms);
            let since_start = Duration::from_millis(u64::from(frame.since_start_ms));
            let now = Now { time, since_start, synchronised: false };
            let mut act = |action: Action<'_>| {
                let Action::Window { window, clock_synced } = action else { return };
                seq = seq.wrapping_add(1);
                let window = DensityMessage {
                    site: description.camera_id.clone(),
                    seq,
                    clock_synced,
                    report: window.report.clone(),
                    calibration: window.calibration.clone(),
                    model: ModelRef { name: Name::new(), sha256: [0; 32] },
                };
                let len = wire::encode(&window, &mut message.bytes).map(<[u8]>::len);
                if let Ok(len) = len {
                    message.len = len as u32;
                    outbox.push(&message);
                }
            };
            let outcome = Outcome::Measured { preset: 0, counts: &counts, moves: None };
            // Without stages none gives up.
            let _ = sensor.turn(now, time, &outcome, &mut act);
            let shown = sensor.tick(now, false, &mut act);
            let _ = board.status_led.set(shown.led_on);
            let _ = board.camera_power.set(shown.camera_power_on);
            let _ = board.watchdog.feed();
        }
    }
}

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("verge-mcu is firmware: build it with --target thumbv7em-none-eabihf");
    std::process::exit(64);
}
