//! Packing and unpacking side by side, without waiting for the pool.
//!
//! A task's thread and the writer's thread are no part of rayon's pool. What they hand to it waits until a
//! thread of the pool has nothing else to do, and during a long solve that is at the end of the solve: a
//! recording of two seconds took forty. So they start threads of their own, as many as the pool has, which
//! the system lets run at once. Inside the pool its own threads do the work.

use rayon::prelude::*;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

/// The results of `work` for all items, in their order.
pub(crate) fn map<T: Sync, R: Send>(items: &[T], work: impl Fn(&T) -> R + Send + Sync) -> Vec<R> {
    if rayon::current_thread_index().is_some() {
        return items.par_iter().map(work).collect();
    }
    let threads = rayon::current_num_threads().min(items.len());
    if threads < 2 {
        return items.iter().map(work).collect();
    }
    let next = AtomicUsize::new(0);
    let some = || {
        let mut done = Vec::new();
        loop {
            let at = next.fetch_add(1, Ordering::Relaxed);
            match items.get(at) {
                Some(item) => done.push((at, work(item))),
                None => return done,
            }
        }
    };
    let mut done = thread::scope(|scope| {
        let others: Vec<_> = (1..threads).map(|_| scope.spawn(some)).collect();
        let mut done = some();
        others
            .into_iter()
            .for_each(|other| done.extend(other.join().unwrap_or_else(|panic| resume_unwind(panic))));
        done
    });
    done.sort_unstable_by_key(|(at, _)| *at);
    done.into_iter().map(|(_, result)| result).collect()
}

/// The results of both.
pub(crate) fn both<A: Send, B: Send>(a: impl FnOnce() -> A + Send, b: impl FnOnce() -> B + Send) -> (A, B) {
    if rayon::current_thread_index().is_some() {
        return rayon::join(a, b);
    }
    thread::scope(|scope| {
        let b = scope.spawn(b);
        (a(), b.join().unwrap_or_else(|panic| resume_unwind(panic)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::channel;

    #[test]
    fn results_stand_in_the_order_of_items_inside_and_outside_the_pool() {
        let items: Vec<usize> = (0..1000).collect();
        let expected: Vec<usize> = items.iter().map(|i| i * i).collect();
        assert_eq!(map(&items, |i| i * i), expected);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
        assert_eq!(pool.install(|| map(&items, |i| i * i)), expected);
        assert_eq!(map(&items[..0], |i| i * i), [0; 0]);
        assert_eq!(both(|| 1, || "two"), (1, "two"));
    }

    #[test]
    fn work_from_outside_is_done_while_the_whole_pool_is_busy() {
        // Every thread of the pool waits for a word that is only given when the work is done.
        let (give, wait) = channel::<()>();
        let wait = std::sync::Mutex::new(wait);
        let wait: &'static _ = Box::leak(Box::new(wait));
        for _ in 0..rayon::current_num_threads() {
            rayon::spawn(move || {
                let _ = wait.lock().map(|wait| wait.recv());
            });
        }
        assert_eq!(map(&[1, 2, 3], |i| i + 1), [2, 3, 4]);
        assert_eq!(both(|| 1, || 2), (1, 2));
        drop(give);
    }
}
