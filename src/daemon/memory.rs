//! What the allocator keeps of memory that was given back.
//!
//! Owns settings of glibc's. Left to itself it learns from each large buffer that is given back:
//! later ones of that size then lie among small ones, where holes stay, and a box that got one
//! picture of 16 megapixels never had that memory again. Other C libraries give large buffers back.

/// Smallest buffer that has pages of its own, bytes: pictures from 5 megapixels on. The largest
/// tensors of a net are smaller: they come and go many times a second.
#[cfg(target_env = "gnu")]
const LARGE: i32 = 16 << 20;

/// The same while a model is loaded: graphs and weights of a few steps, each larger than what
/// stays in the end. What has pages of its own leaves no hole.
#[cfg(target_env = "gnu")]
const LARGE_FOR_LOADING: i32 = 32 << 10;

/// Has large buffers go back to the system as soon as they are given back.
pub(super) fn give_back_large_buffers() {
    #[cfg(target_env = "gnu")]
    for parameter in [libc::M_MMAP_THRESHOLD, libc::M_TRIM_THRESHOLD] {
        set(parameter, LARGE);
    }
}

/// Does `load`, which takes much memory and keeps little of it; the rest goes back to the system
/// when it is done.
pub(super) fn loading<T>(load: impl FnOnce() -> T) -> T {
    #[cfg(target_env = "gnu")]
    set(libc::M_MMAP_THRESHOLD, LARGE_FOR_LOADING);
    let made = load();
    #[cfg(target_env = "gnu")]
    {
        set(libc::M_MMAP_THRESHOLD, LARGE);
        // SAFETY: it takes a number and locks the allocator; nothing that is in use is touched.
        let _ = unsafe { libc::malloc_trim(0) };
    }
    made
}

#[cfg(target_env = "gnu")]
fn set(parameter: i32, bytes: i32) {
    // SAFETY: it takes two numbers and locks the allocator; buffers that were handed out keep
    // their place, whichever kind it is.
    let _ = unsafe { libc::mallopt(parameter, bytes) };
}
