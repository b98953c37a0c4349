//! Waiting for what other threads do, without the interpreter's lock, until it is done or the user interrupts.

use std::sync::OnceLock;
use std::time::Duration;

use pyo3::prelude::*;
use tokio::runtime::Runtime;

use crate::failure::Failure;

/// How long an interruption may go unnoticed.
const NOTICED: Duration = Duration::from_millis(50);

/// What runs the asynchronous parts of all scenes of this process.
pub(crate) fn runtime() -> &'static Runtime {
    static RUNTIME: OnceLock<Runtime> = OnceLock::new();
    RUNTIME.get_or_init(|| {
        tokio::runtime::Builder::new_multi_thread()
            .thread_name("union3d")
            .enable_all()
            .build()
            .expect("threads can be started")
    })
}

/// Waits for work. When Python raises meanwhile (`KeyboardInterrupt`) nobody waits for it any more; what it had begun may still be done.
pub(crate) fn wait<T: Send + 'static>(
    py: Python<'_>,
    work: impl Future<Output = Result<T, Failure>> + Send + 'static,
) -> Result<T, Failure> {
    let mut working = runtime().spawn(work);
    loop {
        let done = py.detach(|| {
            runtime().block_on(async { tokio::time::timeout(NOTICED, &mut working).await })
        });
        match done {
            Ok(Ok(done)) => return done,
            Ok(Err(error)) => std::panic::resume_unwind(error.into_panic()),
            Err(_) => {
                if let Err(raised) = py.check_signals() {
                    working.abort();
                    return Err(raised.into());
                }
            }
        }
    }
}
