//! Resources that this process uses, from Linux.

use anyhow::{Context, Result};

/// Seconds that all threads have spent on a CPU. Threads that ended are not counted.
pub(crate) fn cpu_seconds() -> Result<f64> {
    let mut nanoseconds = 0u64;
    for task in std::fs::read_dir("/proc/self/task").context("CPU time is read from /proc/self/task")? {
        // A thread may end meanwhile.
        let Ok(text) = std::fs::read_to_string(task?.path().join("schedstat")) else { continue };
        let first = text.split_whitespace().next().context("/proc/self/task/…/schedstat is empty")?;
        nanoseconds += first.parse::<u64>().context("/proc/self/task/…/schedstat")?;
    }
    Ok(nanoseconds as f64 * 1e-9)
}

/// Bytes of memory held now.
pub(crate) fn resident_bytes() -> Result<u64> {
    let status = std::fs::read_to_string("/proc/self/status").context("memory is read from /proc/self/status")?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).context("/proc/self/status has no VmRSS")?;
    let kilobytes: u64 = line.split_whitespace().next().unwrap_or_default().parse().context("VmRSS")?;
    Ok(kilobytes * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_takes_time_and_pages_take_memory() {
        let (time, memory) = (cpu_seconds().expect("Linux"), resident_bytes().expect("Linux"));
        let pages = std::hint::black_box(vec![1u8; 64 << 20]);
        let sum: u64 = (0..10_000_000u64).map(|i| i ^ u64::from(pages[(i % 4096) as usize])).sum();
        std::hint::black_box(sum);
        assert!(cpu_seconds().expect("Linux") > time);
        assert!(resident_bytes().expect("Linux") > memory + (48 << 20));
    }
}
