//! The `streamsplat` program.

fn main() -> std::process::ExitCode {
    memory::keep();
    streamsplat_cli::main()
}

/// Memory of the program.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
mod memory {
    #![expect(unsafe_code, reason = "glibc's allocator is configured through a function of C")]

    /// Keeps freed memory in the program, and one heap for all threads. Each interval allocates as much as the one
    /// before; without this, its pages go back to the system and are zeroed again (docs/performance.md has figures).
    pub fn keep() {
        // The largest threshold that glibc accepts.
        const MMAP_THRESHOLD: libc::c_int = 32 << 20;
        const TOP_PAD: libc::c_int = 64 << 20;
        for (parameter, value) in [
            (libc::M_ARENA_MAX, 1),
            (libc::M_MMAP_THRESHOLD, MMAP_THRESHOLD),
            (libc::M_TRIM_THRESHOLD, libc::c_int::MAX),
            (libc::M_TOP_PAD, TOP_PAD),
        ] {
            // SAFETY: a documented function of glibc, called before there are other threads. A value that it refuses
            // changes nothing.
            unsafe { libc::mallopt(parameter, value) };
        }
    }
}

#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
mod memory {
    /// Nothing to configure.
    pub fn keep() {}
}
