//! Work that may end the process, tried in a process of its own: a crash, an endless loop or a flood of
//! memory there is a refusal here.
//!
//! The library parses files in C and can be ended by a damaged one. A forked copy of this process does the
//! same calls first; docs/decisions/0007 says why a fork. The copy is made under the library's lock, so that
//! the library's state in it is whole. It resets every signal, leaves the standard streams alone, takes no
//! lock of ours, starts no thread, and ends with `_exit`: nothing is flushed or dropped twice. Systems
//! without `fork` try nothing.

use std::time::Duration;

/// What the copy may use.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    /// Processor time between two reports.
    pub cpu: Duration,
    /// Time on the clock between two reports: what waits for a slow disk is not stuck.
    pub quiet: Duration,
    /// Memory beyond what this process has, bytes of address space.
    pub memory: u64,
}

/// How the copy ended when it did not come to the end of its work.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Death {
    /// The last report: what it was about to touch.
    pub at: String,
    /// "it ends the process (signal 11, a wrong memory access)".
    pub how: String,
}

/// Exit code of a copy that wanted more memory than it may use.
#[cfg(unix)]
const OUT_OF_MEMORY: i32 = 3;
/// Exit code of a copy that met more things than it may look at.
#[cfg(unix)]
const TOO_MANY: i32 = 4;

/// What the work says of itself.
pub(crate) enum Report<'a> {
    /// The next thing is touched.
    At(&'a str),
    /// The library wanted memory that it may not have.
    OutOfMemory,
    /// There are more things than the work may look at.
    TooMany,
}

/// No report is longer.
#[cfg(unix)]
const LONGEST_REPORT: usize = 1000;

/// Does the work in a copy of this process, and gives how that ended; the outer error when no copy can be
/// made.
#[cfg(unix)]
pub(crate) fn attempt(
    limits: Limits,
    work: impl FnOnce(&mut dyn FnMut(Report)),
) -> std::io::Result<Result<(), Death>> {
    let (mut ends, mut copy) = ([0; 2], 0);
    // SAFETY: plain calls with valid pointers. The copy has this thread only; it holds the library's lock,
    // which is reentrant, and no other lock of ours. The C library makes its own allocator usable in it.
    // `child` does not return.
    super::locked(|| unsafe {
        if pipe(&mut ends) < 0 {
            return Err(std::io::Error::last_os_error());
        }
        let (mut all, mut before) = (std::mem::zeroed(), std::mem::zeroed());
        libc::sigfillset(&mut all);
        // No signal may meet the copy while it still has this process's handlers.
        libc::pthread_sigmask(libc::SIG_SETMASK, &all, &mut before);
        copy = libc::fork();
        if copy == 0 {
            child(ends[1], limits, &before, work);
        }
        let failed = std::io::Error::last_os_error();
        libc::pthread_sigmask(libc::SIG_SETMASK, &before, std::ptr::null_mut());
        libc::close(ends[1]);
        if copy < 0 {
            libc::close(ends[0]);
            return Err(failed);
        }
        // Until the copy has closed the files that it inherited, it holds their locks: nobody here may close
        // and open one meanwhile.
        let mut ready = 0u8;
        while libc::read(ends[0], (&raw mut ready).cast(), 1) < 0
            && std::io::Error::last_os_error().kind() == std::io::ErrorKind::Interrupted
        {}
        Ok(())
    })?;
    let (last, end) = follow(ends[0], limits.quiet);
    let mut status = 0;
    // SAFETY: `copy` is a child of this process that was not waited for yet, and the descriptor is ours.
    unsafe {
        libc::close(ends[0]);
        if end == End::Silent {
            libc::kill(copy, libc::SIGKILL);
        }
        while libc::waitpid(copy, &mut status, 0) < 0
            && std::io::Error::last_os_error().kind() == std::io::ErrorKind::Interrupted
        {}
    }
    let how = match end {
        End::Done => return Ok(Ok(())),
        End::Silent => format!("it does not come back within {} s", limits.quiet.as_secs()),
        End::Dead => death(status, limits),
    };
    Ok(Err(Death { at: last, how }))
}

/// Without `fork` there is no copy, and nothing is tried.
#[cfg(not(unix))]
pub(crate) fn attempt(
    _: Limits,
    _: impl FnOnce(&mut dyn FnMut(Report)),
) -> std::io::Result<Result<(), Death>> {
    Ok(Ok(()))
}

/// A pipe that programs started meanwhile do not inherit.
#[cfg(any(target_os = "linux", target_os = "android"))]
unsafe fn pipe(ends: &mut [i32; 2]) -> i32 {
    // SAFETY: room for two descriptors.
    unsafe { libc::pipe2(ends.as_mut_ptr(), libc::O_CLOEXEC) }
}

#[cfg(all(unix, not(any(target_os = "linux", target_os = "android"))))]
unsafe fn pipe(ends: &mut [i32; 2]) -> i32 {
    // SAFETY: room for two descriptors, which are then ours.
    unsafe {
        let made = libc::pipe(ends.as_mut_ptr());
        for end in *ends {
            libc::fcntl(end, libc::F_SETFD, libc::FD_CLOEXEC);
        }
        made
    }
}

/// The copy: from here to `_exit`.
#[cfg(unix)]
unsafe fn child(
    reports: i32,
    limits: Limits,
    mask: &libc::sigset_t,
    work: impl FnOnce(&mut dyn FnMut(Report)),
) -> ! {
    // SAFETY: system calls with valid pointers, in a process with one thread.
    unsafe {
        for signal in 1..32 {
            // Who presses Ctrl-C means the process that waits for this one.
            let ignored =
                [libc::SIGINT, libc::SIGTERM, libc::SIGHUP, libc::SIGQUIT, libc::SIGPIPE].contains(&signal);
            libc::signal(signal, if ignored { libc::SIG_IGN } else { libc::SIG_DFL });
        }
        #[cfg(any(target_os = "linux", target_os = "android"))]
        libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGKILL);
        let silent = libc::open(c"/dev/null".as_ptr(), libc::O_RDWR);
        for stream in 0..3 {
            libc::dup2(silent, stream);
        }
        close_all_but(reports);
        send(reports, b"\n");
        let limit =
            |bytes: u64| libc::rlimit { rlim_cur: bytes as libc::rlim_t, rlim_max: bytes as libc::rlim_t };
        libc::setrlimit(libc::RLIMIT_CORE, &limit(0));
        if let Some(held) = address_space() {
            libc::setrlimit(libc::RLIMIT_AS, &limit(held.saturating_add(limits.memory)));
        }
        libc::pthread_sigmask(libc::SIG_SETMASK, mask, std::ptr::null_mut());
    }
    let mut report = |what: Report| {
        let name = match what {
            Report::At(name) => name,
            // SAFETY: ends this process.
            Report::OutOfMemory => unsafe { libc::_exit(OUT_OF_MEMORY) },
            // SAFETY: as above.
            Report::TooMany => unsafe { libc::_exit(TOO_MANY) },
        };
        let mut line: Vec<u8> = name
            .bytes()
            .take(LONGEST_REPORT)
            .map(|byte| if byte == b'\n' || byte == 0 { b' ' } else { byte })
            .collect();
        line.push(b'\n');
        send(reports, &line);
        // From here on the next thing has its time.
        let zero = libc::timeval { tv_sec: 0, tv_usec: 0 };
        let cpu =
            libc::timeval { tv_sec: limits.cpu.as_secs() as _, tv_usec: limits.cpu.subsec_micros() as _ };
        // SAFETY: a valid pointer; the old value is not asked for.
        unsafe { set_timer(&libc::itimerval { it_interval: zero, it_value: cpu }) };
    };
    let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| work(&mut report)));
    if outcome.is_ok() {
        send(reports, b"\0");
    }
    // SAFETY: ends this process.
    unsafe { libc::_exit(i32::from(outcome.is_err())) }
}

/// Closes every inherited file but one and the standard streams.
#[cfg(unix)]
unsafe fn close_all_but(kept: i32) {
    /// Descriptors that are closed one by one where the system cannot close a range.
    const MOST: i32 = 65_536;
    // SAFETY: the copy uses none of them.
    unsafe {
        #[cfg(any(target_os = "linux", target_os = "android"))]
        {
            let below = kept <= 3 || libc::syscall(libc::SYS_close_range, 3, kept - 1, 0) == 0;
            if below && libc::syscall(libc::SYS_close_range, kept + 1, u32::MAX, 0) == 0 {
                return;
            }
        }
        let last = i32::try_from(libc::sysconf(libc::_SC_OPEN_MAX)).unwrap_or(MOST).clamp(0, MOST);
        for descriptor in (3..last).filter(|&descriptor| descriptor != kept) {
            libc::close(descriptor);
        }
    }
}

#[cfg(unix)]
unsafe fn set_timer(value: &libc::itimerval) {
    unsafe extern "C" {
        /// Of POSIX; the binding crate declares it for some systems only.
        fn setitimer(
            which: libc::c_int,
            new: *const libc::itimerval,
            old: *mut libc::itimerval,
        ) -> libc::c_int;
    }
    /// Counts the processor time of the process.
    const ITIMER_PROF: libc::c_int = 2;
    // SAFETY: as the caller promises.
    unsafe { setitimer(ITIMER_PROF, value, std::ptr::null_mut()) };
}

#[cfg(unix)]
fn send(to: i32, bytes: &[u8]) {
    // SAFETY: the buffer is valid. A report that nobody reads any more is lost.
    unsafe { libc::write(to, bytes.as_ptr().cast(), bytes.len()) };
}

/// Bytes of address space of this process, where the system says so.
#[cfg(unix)]
fn address_space() -> Option<u64> {
    let pages: u64 = std::fs::read_to_string("/proc/self/statm").ok()?.split(' ').next()?.parse().ok()?;
    // SAFETY: a plain query.
    Some(pages * u64::try_from(unsafe { libc::sysconf(libc::_SC_PAGESIZE) }).ok()?)
}

#[cfg(unix)]
#[derive(PartialEq, Eq)]
enum End {
    Done,
    Dead,
    Silent,
}

/// Reads reports until they end; gives the last thing that was named.
#[cfg(unix)]
fn follow(reports: i32, quiet: Duration) -> (String, End) {
    let (mut tail, mut last, mut buffer) = (Vec::new(), String::new(), [0u8; 4096]);
    loop {
        let mut waiting = libc::pollfd { fd: reports, events: libc::POLLIN, revents: 0 };
        // SAFETY: one descriptor that is open; the buffer has the stated length.
        let got = unsafe {
            match libc::poll(&mut waiting, 1, i32::try_from(quiet.as_millis()).unwrap_or(i32::MAX)) {
                0 => return (last, End::Silent),
                1.. => libc::read(reports, buffer.as_mut_ptr().cast(), buffer.len()),
                _ => -1,
            }
        };
        if got < 0 && std::io::Error::last_os_error().kind() == std::io::ErrorKind::Interrupted {
            continue;
        }
        let Some(got @ 1..) = usize::try_from(got).ok() else { return (last, End::Dead) };
        for &byte in &buffer[..got] {
            match byte {
                0 => return (last, End::Done),
                b'\n' => last = String::from_utf8_lossy(&std::mem::take(&mut tail)).into_owned(),
                byte => tail.push(byte),
            }
        }
    }
}

/// The end of a process in words.
#[cfg(unix)]
fn death(status: i32, limits: Limits) -> String {
    if !libc::WIFSIGNALED(status) {
        return match libc::WEXITSTATUS(status) {
            OUT_OF_MEMORY => format!("it wants more than {} MiB of memory", limits.memory >> 20),
            TOO_MANY => "it holds more objects than are looked at".into(),
            code => format!("it ends the process (exit code {code})"),
        };
    }
    let signal = libc::WTERMSIG(status);
    let what = match signal {
        libc::SIGPROF => {
            return format!(
                "it does not come back within {:.1} s of processor time",
                limits.cpu.as_secs_f64()
            );
        }
        libc::SIGSEGV | libc::SIGBUS => "a wrong memory access",
        libc::SIGFPE => "a division by zero",
        libc::SIGABRT => "it gave up",
        libc::SIGKILL => "killed from outside, perhaps for want of memory",
        libc::SIGILL => "an instruction that is none",
        _ => "no reason given",
    };
    format!("it ends the process (signal {signal}, {what})")
}

#[cfg(all(test, unix))]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    const LIMITS: Limits =
        Limits { cpu: Duration::from_millis(300), quiet: Duration::from_secs(20), memory: 64 << 20 };

    fn died(work: impl FnOnce(&mut dyn FnMut(Report))) -> Death {
        attempt(LIMITS, work).unwrap().unwrap_err()
    }

    #[test]
    fn work_that_comes_to_its_end_passes_and_changes_nothing_here() {
        let mut here = 1;
        let outcome = attempt(LIMITS, |report| {
            here += 1;
            (0..100_000).for_each(|k| report(Report::At(&format!("/thing {k}"))));
        });
        assert_eq!((outcome.unwrap(), here), (Ok(()), 1), "the copy has its own memory");
    }

    #[test]
    fn a_crash_is_named_with_what_was_touched_last() {
        let death = died(|report| {
            report(Report::At("/whole"));
            report(Report::At("/events/x\n"));
            // SAFETY: the copy ends itself as a division by zero in C would.
            unsafe { libc::raise(libc::SIGFPE) };
        });
        assert_eq!(
            (death.at.as_str(), death.how.as_str()),
            ("/events/x ", "it ends the process (signal 8, a division by zero)")
        );
        let death = died(|_| panic!("a mistake of ours"));
        assert_eq!((death.at.as_str(), death.how.as_str()), ("", "it ends the process (exit code 1)"));
    }

    #[test]
    fn endless_work_and_waiting_end() {
        let death = died(|report| {
            report(Report::At("/loop"));
            let mut turns = 0u64;
            while std::hint::black_box(turns) < u64::MAX {
                turns += 1;
            }
        });
        assert!(death.at == "/loop" && death.how.contains("0.3 s of processor time"), "{death:?}");
        let quiet = Limits { quiet: Duration::from_millis(200), ..LIMITS };
        let death = attempt(quiet, |_| std::thread::sleep(Duration::from_secs(30))).unwrap().unwrap_err();
        assert!(death.how.contains("does not come back"), "{death:?}");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn memory_is_limited() {
        let death = died(|_| drop(std::hint::black_box(vec![1u8; 1 << 30])));
        assert!(death.how.contains("signal 6"), "{death:?}");
        assert!(died(|report| report(Report::OutOfMemory)).how.contains("more than 64 MiB"));
    }
}
