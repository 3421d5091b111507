//! The eye core on a microcontroller: pictures in, out comes whether each is fit to be measured,
//! and by how far the camera has moved.
//!
//! A camera interface beside the microcontroller writes pictures of 320x240 into memory that both
//! see; the lane table with the scene's reference lies in memory-mapped flash. It links `picture`,
//! `scene` with what it learns of the empty road, `alarm` and `lane`, without a panic path and
//! inside a budget of its own (`boards/mcu/eye/memory.x`): the working grid of a picture, its
//! fields and the road's memory take thirty times the RAM of counting. The detector between this
//! core and the counting core (`counting_core.rs`) runs on another processor. `tests/node/run` runs
//! both and measures the stack.
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
    use core::ptr::addr_of_mut;
    use core::time::Duration;
    use cortex_m_rt::entry;
    use verge::alarm::Alarm;
    use verge::picture::{Before, Look};
    use verge::scene::{Aim, Cell, EmptyRoad, Eye, Grid, Guard, Judgement, MeanCell, Reference};

    /// Where pictures come in, verdicts go out, and the lane table lies behind its length: in the
    /// board's PSRAM, which takes the part of memory on a bus.
    const INBOX_AT: usize = 0x2100_0000;
    const OUTBOX_AT: usize = 0x2190_0000;
    const TABLE_AT: usize = 0x21A0_0000;
    /// Columns and rows of a picture, px.
    const WIDTH: usize = 320;
    const HEIGHT: usize = 240;
    const CELLS: usize = WIDTH * HEIGHT;
    /// Cells of the grid with its half: [`Grid::buffer_len`].
    const BUFFER: usize = CELLS + CELLS / 4;
    /// Pictures that wait.
    const PICTURES: usize = 16;

    static mut LUMA: [u8; BUFFER] = [0; BUFFER];
    static mut FIELDS: [Cell; BUFFER] = [[0; 2]; BUFFER];
    static mut BEFORE: [u8; CELLS] = [0; CELLS];
    /// By day and at night: [`EmptyRoad::buffer_len`].
    static mut ROAD: [MeanCell; 2 * CELLS] = [[0; 2]; 2 * CELLS];

    /// One picture, as the camera interface writes it.
    #[repr(C)]
    #[derive(Clone, Copy)]
    struct Arrived {
        since_start_ms: u32,
        /// Where its RGB lies.
        rgb: u32,
    }

    /// The verdict on one picture.
    #[repr(C)]
    #[derive(Clone, Copy)]
    struct Verdict {
        /// 0: fit; 1: unchanged; 2: passed over; 16 and more: withheld, with this alarm's number.
        kind: u32,
        /// Shift of the scene against the table, px.
        shift: [f32; 2],
    }

    #[entry]
    fn main() -> ! {
        let _ = watch();
        // Without a table there is nothing to compare with: the watchdog resets the box.
        loop {
            core::hint::spin_loop();
        }
    }

    fn watch() -> Option<core::convert::Infallible> {
        // SAFETY: the flash is mapped before reset leaves the boot loader, and never written.
        let table = unsafe { table::read(TABLE_AT) }?;
        let references: [Reference; 1] = [table.scene().ok()??];
        let grid = Grid::of(WIDTH, HEIGHT);
        // SAFETY: this function runs once, and nothing else names these.
        let (luma, fields, before, road) = unsafe {
            (
                &mut *addr_of_mut!(LUMA),
                &mut *addr_of_mut!(FIELDS),
                &mut *addr_of_mut!(BEFORE),
                &mut *addr_of_mut!(ROAD),
            )
        };
        let mut eye = Eye::new(grid, &mut luma[..], &mut fields[..])?;
        let mut before = Before::new(&mut before[..]);
        let mut road = EmptyRoad::new(grid, &mut road[..])?;
        let [reference] = &references;
        road.begin_with(reference);
        let mut guard = Guard::new(references.len());
        // SAFETY: the board's PSRAM, whose content is numbers alone.
        let mut inbox = unsafe { Reader::<Arrived, PICTURES>::at(INBOX_AT) };
        // SAFETY: as before, and nothing else writes there.
        let mut outbox = unsafe { Writer::<Verdict, PICTURES>::at(OUTBOX_AT) };
        loop {
            let arrived = inbox.next();
            // SAFETY: the camera interface leaves a picture alone until 15 more have come.
            let rgb = unsafe {
                core::slice::from_raw_parts(arrived.rgb as usize as *const u8, 3 * CELLS)
            };
            let now = Duration::from_millis(u64::from(arrived.since_start_ms));
            eye.look(rgb);
            let look = Look::at(eye.luma(), grid.width);
            let withheld = |alarm: Alarm| 16 + alarm as u32;
            let mut shift = [0.0; 2];
            let kind = if let Some(flaw) = look.flaw() {
                withheld(flaw.into())
            } else if before.repeats(eye.luma(), grid.width) {
                1
            } else {
                let Judgement { aim, shift: seen } = guard.judge(&references, &eye, now);
                if let Some((dx, dy)) = seen {
                    shift = [dx * grid.cell_px(), dy * grid.cell_px()];
                }
                match (aim, seen) {
                    (Aim::Preset(_) | Aim::Unknown, Some(_)) => 0,
                    (Aim::Moved, _) => withheld(Alarm::CameraMoved),
                    _ => 2,
                }
            };
            outbox.push(&Verdict { kind, shift });
        }
    }
}

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("verge-mcu is firmware: build it with --target thumbv7em-none-eabihf");
    std::process::exit(64);
}
