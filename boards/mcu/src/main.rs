//! The I/O node on a Cortex-M4F: a serial line in, up to eight outputs for a signal controller.
//!
//! The board is Arm's MPS2+ with image AN386 (Arm DAI 0386), as `qemu-system-arm` has it: a
//! CMSDK UART at 115,200 baud, the eight user LEDs as outputs, a CMSDK watchdog, and PSRAM that
//! keeps its content over a reset, which plays the part of a flash. What the node does is
//! [`verge::node`]; this file is clock, UART, pins, watchdog. `tests/node/run` runs it.
//!
//! It links inside `memory.x`, stack included, and without a panic path: the panic handler
//! calls a function that does not exist.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod board;
#[cfg(target_os = "none")]
mod panic;

#[cfg(target_os = "none")]
mod firmware {
    use crate::board::{self, MAX_LINE, Psram, Sending};
    use core::time::Duration;
    use cortex_m_rt::{entry, exception};
    use verge::hal::Switch;
    use verge::node::link::encode;
    use verge::node::protocol::write_answer;
    use verge::node::{MAX_ANSWER, Node};

    /// Half a period of the heartbeat.
    const HEARTBEAT: Duration = Duration::from_millis(500);

    #[entry]
    fn main() -> ! {
        let restarts = board::start();
        let mut outputs = board::outputs();
        let mut heartbeat = board::heartbeat();
        let mut clock = board::Clock::default();
        let mut sending = Sending::default();
        let mut node = Node::start(Psram);
        let mut latency_us = 0;
        loop {
            if board::bytes_lost() {
                node.bytes_lost();
            }
            let now = clock.now();
            let heard = node.messages();
            while let Some(byte) = board::next_byte() {
                let Some(answer) = node.byte(now, byte) else { continue };
                let (mut content, mut line) = ([0; MAX_ANSWER], [0; MAX_LINE]);
                if let Some(bytes) = write_answer(&answer, &mut content)
                    .and_then(|content| encode(content, &mut line))
                {
                    sending.begin(bytes);
                }
            }
            let pins = node.pins(now);
            for (bit, output) in outputs.iter_mut().enumerate() {
                // A register of this board cannot fail.
                let _ = output.set(pins & (1 << bit) != 0);
            }
            if let Some(came) = board::frame_came()
                && node.messages() != heard
            {
                latency_us = latency_us.max(board::microseconds().wrapping_sub(came));
            }
            node.board(now, latency_us, restarts);
            let _ = heartbeat.set((now.as_millis() / HEARTBEAT.as_millis()) % 2 == 0);
            sending.go_on();
            board::feed_watchdog();
            // The next millisecond or byte wakes it.
            cortex_m::asm::wfi();
        }
    }

    #[exception]
    fn SysTick() {
        board::tick();
    }

    /// Every interrupt and fault: the UART's, or something that only the watchdog can end.
    #[exception]
    unsafe fn DefaultHandler(interrupt: i16) {
        if interrupt == board::UART_RECEIVED {
            board::receive();
        } else {
            loop {
                cortex_m::asm::nop();
            }
        }
    }

    #[exception]
    unsafe fn HardFault(_: &cortex_m_rt::ExceptionFrame) -> ! {
        loop {
            cortex_m::asm::nop();
        }
    }
}

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("verge-mcu is firmware: build it with --target thumbv7em-none-eabihf");
    std::process::exit(64);
}
