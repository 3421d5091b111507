//! Memory that is held and not needed: buffers that were given back, code that ran once.
//!
//! Owns settings of glibc's allocator. Left to itself it learns from each large buffer that is given
//! back: later ones of that size then lie among small ones, where holes stay, and a box that got one
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
/// when it is done, with the code that did it.
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
    #[cfg(target_os = "linux")]
    forget_code();
    made
}

/// Takes the program's code and constants out of the process's memory. What runs again comes back,
/// mostly from the system's cache of files: a few hundred pages for each picture's work, where
/// reading and planning a model had touched most of the program.
#[cfg(target_os = "linux")]
fn forget_code() {
    use std::ffi::{c_int, c_void};

    unsafe extern "C" fn first(info: *mut libc::dl_phdr_info, _: usize, _: *mut c_void) -> c_int {
        // SAFETY: the loader's description of the program, which stays as long as the program.
        let (base, headers) = unsafe {
            let info = &*info;
            (info.dlpi_addr, std::slice::from_raw_parts(info.dlpi_phdr, info.dlpi_phnum.into()))
        };
        // SAFETY: it takes a number and gives one.
        let page = usize::try_from(unsafe { libc::sysconf(libc::_SC_PAGESIZE) }).unwrap_or(0);
        if page == 0 {
            return 1;
        }
        for header in headers {
            if header.p_type != libc::PT_LOAD || header.p_flags & libc::PF_W != 0 {
                continue;
            }
            // Only pages that lie in such a segment as a whole.
            let start = (base + header.p_vaddr) as usize;
            let end = (start + header.p_filesz as usize) / page * page;
            let start = start.next_multiple_of(page);
            if start < end {
                let pages = start as *mut c_void;
                // SAFETY: pages of the file that nobody may write; the next one who touches them
                // gets them from the file again. That holds as long as the loader changes nothing in
                // them (Rust's programs have no text relocations) and no packer, such as UPX, has put
                // them there. A debugger's breakpoints are lost.
                let _ = unsafe { libc::madvise(pages, end - start, libc::MADV_DONTNEED) };
            }
        }
        // The first one is the program; libraries come behind it.
        1
    }
    // SAFETY: `first` is called with what it takes, and does not unwind.
    let _ = unsafe { libc::dl_iterate_phdr(Some(first), std::ptr::null_mut()) };
}

#[cfg(target_env = "gnu")]
fn set(parameter: i32, bytes: i32) {
    // SAFETY: it takes two numbers and locks the allocator; buffers that were handed out keep
    // their place, whichever kind it is.
    let _ = unsafe { libc::mallopt(parameter, bytes) };
}
