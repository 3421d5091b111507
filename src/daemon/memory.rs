//! What the allocator keeps of memory that was given back.
//!
//! Owns one setting of glibc's. Left to itself it learns from each large buffer that is given back:
//! later ones of that size then lie among small ones, where holes stay, and a box that got one
//! picture of 16 megapixels never had that memory again. Other C libraries give large buffers back.

/// Smallest buffer that has pages of its own, bytes: pictures from 5 megapixels on. The largest
/// tensors of a net are smaller: they come and go many times a second.
#[cfg(target_env = "gnu")]
const LARGE: i32 = 16 << 20;

/// Has large buffers go back to the system as soon as they are given back.
pub(super) fn give_back_large_buffers() {
    #[cfg(target_env = "gnu")]
    for parameter in [libc::M_MMAP_THRESHOLD, libc::M_TRIM_THRESHOLD] {
        // SAFETY: it takes two numbers, and touches no memory of ours; there is no second thread yet.
        let _ = unsafe { libc::mallopt(parameter, LARGE) };
    }
}
