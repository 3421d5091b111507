//! Registers of the MPS2+ with image AN386 (Arm DAI 0386; Cortex-M System Design Kit, DDI 0479).
//!
//! Owns every address and every `unsafe`. Another board brings another file of this shape: clock,
//! UART, pins, watchdog, flash.

use core::ptr;
use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, AtomicUsize, Ordering};
use core::time::Duration;
use cortex_m::peripheral::{SYST, syst::SystClkSource};
use embedded_hal::digital::{Error, ErrorKind, ErrorType, OutputPin};
use embedded_storage::nor_flash::{
    ErrorType as FlashErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};
use verge::hal::PinSwitch;
use verge::node::{MAX_ANSWER, MAX_OUTPUTS};

/// The core's clock, Hz.
const CLOCK_HZ: u32 = 25_000_000;
const BAUD: u32 = 115_200;
/// Time after which the watchdog interrupts; after as much again it resets.
const WATCHDOG: Duration = Duration::from_millis(500);

const UART: usize = 0x4000_4000;
const UART_DATA: usize = UART;
const UART_STATE: usize = UART + 0x4;
const UART_CONTROL: usize = UART + 0x8;
const UART_INTERRUPT: usize = UART + 0xC;
const UART_BAUD_DIVIDER: usize = UART + 0x10;
const TRANSMIT_FULL: u32 = 1;
const RECEIVE_FULL: u32 = 1 << 1;
const RECEIVE_OVERRUN: u32 = 1 << 3;
/// Transmitter, receiver, and the receiver's interrupt.
const UART_ON: u32 = 1 | 1 << 1 | 1 << 3;
/// The receiver's interrupt.
pub const UART_RECEIVED: i16 = 0;
/// Interrupt Set-Enable Register 0 (Armv7-M ARM, B3.4.4).
const NVIC_ENABLE: usize = 0xE000_E100;

const WATCHDOG_LOAD: usize = 0x4000_8000;
const WATCHDOG_CONTROL: usize = 0x4000_8008;
const WATCHDOG_CLEAR: usize = 0x4000_800C;
/// Count, interrupt, and reset when the interrupt stays.
const WATCHDOG_ON: u32 = 1 | 1 << 1;

/// LEDs of FPGAIO; bit 0 is the heartbeat.
const FPGAIO_LED: usize = 0x4002_8000;
/// Eight user LEDs of the serial configuration controller.
const SCC_LED: usize = 0x4002_F004;

const PSRAM: usize = 0x2100_0000;
/// Bytes of PSRAM in use: two erase blocks.
const PSRAM_LEN: usize = 2 * Psram::ERASE_SIZE;

/// Longest answer on the line, its framing included.
pub const MAX_LINE: usize = MAX_ANSWER + 4;

fn read(register: usize) -> u32 {
    // SAFETY: only called with the addresses above, each a word-aligned register of this board.
    unsafe { ptr::read_volatile(register as *const u32) }
}

fn write(register: usize, value: u32) {
    // SAFETY: as for `read`; none of these registers changes memory that Rust owns.
    unsafe { ptr::write_volatile(register as *mut u32, value) }
}

/// Milliseconds since the start; wraps after 49 days.
static MILLISECONDS: AtomicU32 = AtomicU32::new(0);

/// Starts without a power-up. `.uninit` keeps what it was; after power-up that is noise, which
/// the pattern in the other word tells.
#[unsafe(link_section = ".uninit.restarts")]
static RESTARTS: [AtomicU32; 2] = [const { AtomicU32::new(0) }; 2];
const RESTARTED: u32 = 0x5EED_CAFE;

/// Starts clock, UART and watchdog. Returns the starts since power came, this one not counted.
pub fn start() -> u32 {
    let [pattern, count] = &RESTARTS;
    let restarts = match pattern.swap(RESTARTED, Ordering::Relaxed) {
        RESTARTED => count.load(Ordering::Relaxed).wrapping_add(1),
        _ => 0,
    };
    count.store(restarts, Ordering::Relaxed);
    write(WATCHDOG_LOAD, CLOCK_HZ / 1000 * WATCHDOG.as_millis() as u32);
    write(WATCHDOG_CONTROL, WATCHDOG_ON);
    write(UART_BAUD_DIVIDER, CLOCK_HZ / BAUD);
    write(UART_CONTROL, UART_ON);
    // SAFETY: nothing else uses the core's peripherals, and this runs once.
    let mut core = unsafe { cortex_m::Peripherals::steal() };
    core.SYST.set_clock_source(SystClkSource::Core);
    core.SYST.set_reload(CLOCK_HZ / 1000 - 1);
    core.SYST.clear_current();
    core.SYST.enable_counter();
    core.SYST.enable_interrupt();
    write(NVIC_ENABLE, 1 << UART_RECEIVED);
    restarts
}

/// A millisecond has passed.
pub fn tick() {
    MILLISECONDS.fetch_add(1, Ordering::Relaxed);
}

/// Time since the start: milliseconds, and microseconds of the next one.
fn time() -> (u32, u32) {
    loop {
        let ms = MILLISECONDS.load(Ordering::Relaxed);
        let left = SYST::get_current();
        if MILLISECONDS.load(Ordering::Relaxed) == ms {
            return (ms, (CLOCK_HZ / 1000 - 1).wrapping_sub(left) / (CLOCK_HZ / 1_000_000));
        }
    }
}

/// Time since the start, µs; wraps after 71 minutes.
pub fn microseconds() -> u32 {
    let (ms, us) = time();
    ms.wrapping_mul(1000).wrapping_add(us)
}

/// Time since the start, over the wrap of the millisecond counter.
#[derive(Debug, Default)]
pub struct Clock {
    latest_ms: u32,
    wraps: u32,
}

impl Clock {
    /// The time now, to the millisecond; to be asked at least once in 49 days.
    pub fn now(&mut self) -> Duration {
        let (ms, _) = time();
        if ms < self.latest_ms {
            self.wraps = self.wraps.wrapping_add(1);
        }
        self.latest_ms = ms;
        Duration::from_millis(u64::from(self.wraps) << 32 | u64::from(ms))
    }
}

/// Bytes between the UART's interrupt and the main loop: 22 ms of the line.
const RING: usize = 256;
static BYTES: [AtomicU8; RING] = [const { AtomicU8::new(0) }; RING];
static WRITTEN: AtomicUsize = AtomicUsize::new(0);
static READ: AtomicUsize = AtomicUsize::new(0);
static LOST: AtomicBool = AtomicBool::new(false);
/// When the latest zero, a frame's end, came: µs, and whether one has come.
static FRAME_CAME_US: AtomicU32 = AtomicU32::new(0);
static FRAME_CAME: AtomicBool = AtomicBool::new(false);

/// The UART has received: takes its bytes. Runs in the interrupt.
pub fn receive() {
    write(UART_INTERRUPT, 1 << 1);
    while read(UART_STATE) & RECEIVE_FULL != 0 {
        let byte = read(UART_DATA) as u8;
        let written = WRITTEN.load(Ordering::Relaxed);
        if written.wrapping_sub(READ.load(Ordering::Acquire)) >= RING {
            LOST.store(true, Ordering::Relaxed);
            continue;
        }
        if let Some(place) = BYTES.get(written % RING) {
            place.store(byte, Ordering::Relaxed);
        }
        WRITTEN.store(written.wrapping_add(1), Ordering::Release);
        if byte == 0 {
            FRAME_CAME_US.store(microseconds(), Ordering::Relaxed);
            FRAME_CAME.store(true, Ordering::Release);
        }
    }
    if read(UART_STATE) & RECEIVE_OVERRUN != 0 {
        write(UART_STATE, RECEIVE_OVERRUN);
        LOST.store(true, Ordering::Relaxed);
    }
}

/// The next byte of the line.
pub fn next_byte() -> Option<u8> {
    let next = READ.load(Ordering::Relaxed);
    if next == WRITTEN.load(Ordering::Acquire) {
        return None;
    }
    let byte = BYTES.get(next % RING)?.load(Ordering::Relaxed);
    READ.store(next.wrapping_add(1), Ordering::Release);
    Some(byte)
}

/// Whether bytes were lost since this was asked last.
pub fn bytes_lost() -> bool {
    // No read-modify-write across an interrupt is needed: a loss in between is reported at the next call.
    LOST.load(Ordering::Relaxed) && LOST.swap(false, Ordering::Relaxed)
}

/// When a frame's end came, µs, if one came since this was asked last.
pub fn frame_came() -> Option<u32> {
    (READ.load(Ordering::Relaxed) == WRITTEN.load(Ordering::Acquire)
        && FRAME_CAME.swap(false, Ordering::Acquire))
    .then(|| FRAME_CAME_US.load(Ordering::Relaxed))
}

/// An answer on its way out, byte by byte as the UART takes them.
#[derive(Debug)]
pub struct Sending {
    line: [u8; MAX_LINE],
    len: usize,
    sent: usize,
}

impl Default for Sending {
    fn default() -> Self {
        Self { line: [0; MAX_LINE], len: 0, sent: 0 }
    }
}

impl Sending {
    /// Sends `bytes`; an answer that is still on its way is cut, and who asked asks again.
    pub fn begin(&mut self, bytes: &[u8]) {
        for (place, &byte) in self.line.iter_mut().zip(bytes) {
            *place = byte;
        }
        (self.len, self.sent) = (bytes.len(), 0);
    }

    /// Gives the UART what it takes now.
    pub fn go_on(&mut self) {
        while self.sent < self.len && read(UART_STATE) & TRANSMIT_FULL == 0 {
            let Some(&byte) = self.line.get(self.sent) else { break };
            write(UART_DATA, u32::from(byte));
            self.sent += 1;
        }
    }
}

/// Starts the watchdog's count again.
pub fn feed_watchdog() {
    write(WATCHDOG_CLEAR, 1);
}

/// A LED, by register and bit.
#[derive(Debug)]
pub struct Led {
    register: usize,
    bit: u8,
}

/// A register does not fail.
#[derive(Debug)]
pub enum Never {}

impl Error for Never {
    fn kind(&self) -> ErrorKind {
        match *self {}
    }
}

impl ErrorType for Led {
    type Error = Never;
}

impl OutputPin for Led {
    fn set_low(&mut self) -> Result<(), Never> {
        write(self.register, read(self.register) & !(1 << self.bit));
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Never> {
        write(self.register, read(self.register) | 1 << self.bit);
        Ok(())
    }
}

/// The node's outputs.
pub fn outputs() -> [PinSwitch<Led>; MAX_OUTPUTS] {
    [0, 1, 2, 3, 4, 5, 6, 7].map(|bit| PinSwitch::active_high(Led { register: SCC_LED, bit }))
}

/// The LED that shows that the program runs.
pub fn heartbeat() -> PinSwitch<Led> {
    PinSwitch::active_high(Led { register: FPGAIO_LED, bit: 0 })
}

/// PSRAM that behaves as NOR flash does: a write clears bits, an erase sets them.
#[derive(Debug)]
pub struct Psram;

/// Outside the flash.
#[derive(Debug)]
pub struct OutOfBounds;

impl NorFlashError for OutOfBounds {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::OutOfBounds
    }
}

impl FlashErrorType for Psram {
    type Error = OutOfBounds;
}

fn within(offset: u32, len: usize) -> Result<usize, OutOfBounds> {
    let from = offset as usize;
    match from.checked_add(len) {
        Some(end) if end <= PSRAM_LEN => Ok(PSRAM + from),
        _ => Err(OutOfBounds),
    }
}

impl ReadNorFlash for Psram {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), OutOfBounds> {
        let from = within(offset, bytes.len())?;
        for (address, byte) in (from..).zip(bytes) {
            // SAFETY: `within` holds the address inside the PSRAM, which nothing else uses.
            *byte = unsafe { ptr::read_volatile(address as *const u8) };
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        PSRAM_LEN
    }
}

impl NorFlash for Psram {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = 4096;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), OutOfBounds> {
        let len = to.checked_sub(from).ok_or(OutOfBounds)? as usize;
        let from = within(from, len)?;
        for address in from..from + len {
            // SAFETY: as in `read`.
            unsafe { ptr::write_volatile(address as *mut u8, 0xFF) };
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), OutOfBounds> {
        let from = within(offset, bytes.len())?;
        for (address, byte) in (from..).zip(bytes) {
            // SAFETY: as in `read`.
            unsafe {
                let old = ptr::read_volatile(address as *const u8);
                ptr::write_volatile(address as *mut u8, old & byte);
            }
        }
        Ok(())
    }
}
