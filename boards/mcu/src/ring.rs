//! Memory that two processors see: one writes entries in turn, the other reads them.
//!
//! Owns the order of reading and its `unsafe`. The writer sets `written` after the entry; entries
//! that it overwrites before they are read are lost, as pictures are.

use core::ptr::{addr_of, addr_of_mut};
use core::sync::atomic::{Ordering, compiler_fence};

/// `N` entries, and how many were written since the start.
#[repr(C, align(16))]
#[derive(Debug)]
pub struct Ring<T, const N: usize> {
    written: u32,
    entries: [T; N],
}

/// The reader's end.
#[derive(Debug)]
pub struct Reader<T, const N: usize> {
    ring: *const Ring<T, N>,
    read: u32,
}

impl<T: Copy, const N: usize> Reader<T, N> {
    /// Reads the ring at that address from its first entry on.
    ///
    /// # Safety
    /// Memory of the ring's size is there for as long as the program runs, and every content of an
    /// entry is a `T`.
    pub const unsafe fn at(address: usize) -> Self {
        Self { ring: address as *const Ring<T, N>, read: 0 }
    }

    /// The next entry, once it is written.
    pub fn next(&mut self) -> T {
        // SAFETY: by `at`; the writer is another processor, hence volatile.
        while unsafe { addr_of!((*self.ring).written).read_volatile() } == self.read {
            core::hint::spin_loop();
        }
        compiler_fence(Ordering::Acquire);
        let index = self.read as usize % N;
        self.read = self.read.wrapping_add(1);
        // SAFETY: by `at`; `index` lies inside the ring.
        unsafe { addr_of!((*self.ring).entries).cast::<T>().add(index).read_volatile() }
    }
}

/// The writer's end.
#[derive(Debug)]
pub struct Writer<T, const N: usize> {
    ring: *mut Ring<T, N>,
    written: u32,
}

impl<T: Copy, const N: usize> Writer<T, N> {
    /// Writes the ring at that address from its first entry on.
    ///
    /// # Safety
    /// As of [`Reader::at`], and nothing else writes there.
    pub const unsafe fn at(address: usize) -> Self {
        Self { ring: address as *mut Ring<T, N>, written: 0 }
    }

    /// Adds an entry.
    pub fn push(&mut self, entry: &T) {
        let index = self.written as usize % N;
        self.written = self.written.wrapping_add(1);
        // SAFETY: by `at`; `index` lies inside the ring.
        unsafe {
            addr_of_mut!((*self.ring).entries).cast::<T>().add(index).write_volatile(*entry);
            compiler_fence(Ordering::Release);
            addr_of_mut!((*self.ring).written).write_volatile(self.written);
        }
    }
}
