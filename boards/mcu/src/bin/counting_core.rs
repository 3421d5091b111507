//! The counting core on a microcontroller: Cortex-M4F, detections in, messages out.
//!
//! A detector beside the microcontroller writes one frame's boxes into `INBOX`, the lane
//! table lies in external flash, messages leave through `OUTBOX`. What this file is for: it links
//! `units`, `lane`, `density`, `wire`, `health` and `hal` inside `memory.x` (the link fails when they
//! outgrow it) and without a single panic path (the panic handler calls a function that
//! does not exist, so that a reachable panic is a link error).
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod firmware {
    use core::ptr::addr_of_mut;
    use core::time::Duration;
    use cortex_m_rt::entry;
    use verge::density::{Aggregator, Start};
    use verge::hal::{Board, Switch, Watchdog};
    use verge::health::{Event, Health};
    use verge::lane::{LaneTable, Name};
    use verge::units::{ImagePoint, UtcMs, VehicleClass};
    use verge::wire::{self, CalibrationRef, DensityMessage, MAX_DENSITY_MESSAGE, ModelRef};

    /// Where the lane table lies: memory-mapped QSPI flash of an STM32F4 (RM0386, 13.3).
    const TABLE_AT: *const u8 = 0x9000_0000 as *const u8;
    /// Bytes of a 320x240 table: header, description, five bytes a cell, checksum.
    const TABLE_LEN: usize = 12 + 200 + 320 * 240 * 5 + 4;
    /// Most vehicles of one frame: eight lanes of 50 m at jam density and a half more.
    const MAX_BOXES: usize = 96;
    /// One frame a second, windows of a minute.
    const INTERVAL: Duration = Duration::from_secs(1);
    const WINDOW: Duration = Duration::from_secs(60);

    /// One frame's vehicles as the detector writes them.
    #[repr(C)]
    struct Frame {
        time_ms: i64,
        count: u32,
        contacts: [ImagePoint; MAX_BOXES],
        classes: [u8; MAX_BOXES],
    }

    static mut INBOX: Frame = Frame {
        time_ms: 0,
        count: 0,
        contacts: [ImagePoint { u: 0.0, v: 0.0 }; MAX_BOXES],
        classes: [0; MAX_BOXES],
    };
    static mut OUTBOX: [u8; MAX_DENSITY_MESSAGE] = [0; MAX_DENSITY_MESSAGE];

    unsafe extern "C" {
        /// Defined nowhere: a panic path that the linker cannot drop fails the link.
        fn the_core_of_verge_must_not_panic() -> !;
    }

    #[panic_handler]
    fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
        // SAFETY: never runs; the symbol is missing, so the link fails where it could.
        unsafe { the_core_of_verge_must_not_panic() }
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
        // SAFETY: the flash is mapped before reset leaves the boot loader and never written.
        let bytes = unsafe { core::slice::from_raw_parts(TABLE_AT, TABLE_LEN) };
        let table = LaneTable::parse(bytes).ok()?;
        let (lanes, cell_m) = (&table.description().lanes, table.description().cell_length_m);
        let start = Start::AtNextWindow;
        let mut line =
            Aggregator::<1>::new(lanes, cell_m, &[WINDOW], INTERVAL, 0.75, start).ok()?;
        let mut health = Health::new(INTERVAL, Duration::ZERO);
        let mut seq = 0u64;
        loop {
            // SAFETY: single core, and the detector writes the next frame only after this
            // one's message has left.
            let frame = unsafe { addr_of_mut!(INBOX).read_volatile() };
            let mut counts = line.counts();
            for (&contact, &class) in
                frame.contacts.iter().zip(&frame.classes).take(frame.count as usize)
            {
                let class = VehicleClass::ALL.get(usize::from(class)).copied();
                if let Some(place) = table.place(contact) {
                    counts.add(place.lane, place.s_m, class.unwrap_or(VehicleClass::Vehicle));
                }
            }
            let time = UtcMs(frame.time_ms);
            for report in line.observe(time, &counts) {
                seq = seq.wrapping_add(1);
                let message = DensityMessage {
                    site: table.description().camera_id.clone(),
                    seq,
                    clock_synced: false,
                    report,
                    calibration: CalibrationRef {
                        id: table.description().calibration_id.clone(),
                        sha256: table.description().calibration_sha256,
                        rel_err: table.description().length_rel_err,
                    },
                    model: ModelRef { name: Name::new(), sha256: [0; 32] },
                };
                // SAFETY: only this loop touches the outbox while it is being written.
                let outbox = unsafe { &mut *addr_of_mut!(OUTBOX) };
                let _ = wire::encode(&message, outbox);
            }
            let since_start = Duration::from_millis(frame.time_ms.unsigned_abs());
            let actions = health.on(Event::Measured, since_start);
            let _ = board.status_led.set(actions.led_on);
            let _ = board.camera_power.set(actions.camera_power_on);
            let _ = board.watchdog.feed();
        }
    }
}

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("verge-mcu is firmware: build it with --target thumbv7em-none-eabihf");
    std::process::exit(64);
}
