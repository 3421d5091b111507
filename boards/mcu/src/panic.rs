//! The panic handler of every firmware: a call of a function that does not exist, so that a panic
//! path that the linker cannot drop fails the link.

unsafe extern "C" {
    /// Defined nowhere.
    fn the_core_of_verge_must_not_panic() -> !;
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    // SAFETY: never runs; the symbol is missing, so the link fails where it could.
    unsafe { the_core_of_verge_must_not_panic() }
}
