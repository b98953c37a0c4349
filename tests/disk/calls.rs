//! The C library's file calls, taken over for this whole test program.
//!
//! A function that the program defines itself is linked before the C library's of the same name. So every call that SQLite
//! and the standard library make arrives here, is shown to [`super::disk`], and goes on to the kernel by its number.
//! Which calls these are is no matter of trust: `the_record_holds_all_that_reaches_the_files` compares the result.
#![expect(unsafe_code, reason = "functions called by C, and calls of the kernel")]

use std::ffi::{CStr, c_char, c_int, c_long, c_void};

use libc::{mode_t, off_t, size_t, ssize_t};

use super::disk::{self, At};

/// A call of the kernel; -1 with `errno` set when it fails.
macro_rules! kernel {
    ($number:ident $(, $argument:expr)*) => {
        // SAFETY: the arguments are those of the C function that this stands for, unchanged.
        unsafe { libc::syscall(libc::$number $(, $argument)*) }
    };
}

/// Sets `errno` and answers what a call that failed answers.
fn failed(errno: c_int) -> c_long {
    // SAFETY: every thread has its own, always.
    unsafe { *libc::__errno_location() = errno };
    -1
}

fn int(result: c_long) -> c_int {
    c_int::try_from(result).expect("a descriptor, 0 or -1")
}

fn size(result: c_long) -> ssize_t {
    ssize_t::try_from(result).expect("a size fits")
}

/// # Safety
/// `path` is a C string.
unsafe fn text<'a>(path: *const c_char) -> &'a CStr {
    // SAFETY: the caller's promise.
    unsafe { CStr::from_ptr(path) }
}

fn open_at(at: c_int, path: *const c_char, flags: c_int, mode: mode_t) -> c_int {
    let kernel = || kernel!(SYS_openat, at, path, flags, mode);
    // SAFETY: what C promises of a path.
    let place = At(at, unsafe { text(path) });
    int(disk::open(place, flags, kernel).unwrap_or_else(failed))
}

// The mode is the last of a variable number of arguments: on the processors that Linux runs on it arrives where a fixed
// one does.
#[unsafe(no_mangle)]
extern "C" fn open(path: *const c_char, flags: c_int, mode: mode_t) -> c_int {
    open_at(libc::AT_FDCWD, path, flags, mode)
}

#[unsafe(no_mangle)]
extern "C" fn open64(path: *const c_char, flags: c_int, mode: mode_t) -> c_int {
    open_at(libc::AT_FDCWD, path, flags, mode)
}

#[unsafe(no_mangle)]
extern "C" fn openat(at: c_int, path: *const c_char, flags: c_int, mode: mode_t) -> c_int {
    open_at(at, path, flags, mode)
}

#[unsafe(no_mangle)]
extern "C" fn openat64(at: c_int, path: *const c_char, flags: c_int, mode: mode_t) -> c_int {
    open_at(at, path, flags, mode)
}

#[unsafe(no_mangle)]
extern "C" fn close(file: c_int) -> c_int {
    disk::close(file);
    int(kernel!(SYS_close, file))
}

/// Where the file's own position is.
fn position(file: c_int) -> Option<u64> {
    u64::try_from(kernel!(SYS_lseek, file, 0, libc::SEEK_CUR)).ok()
}

fn place(at: off_t) -> Option<u64> {
    u64::try_from(at).ok()
}

fn read_by(file: c_int, to: *mut c_void, kernel: impl FnOnce() -> c_long) -> ssize_t {
    let read = disk::read(file, |spoil| {
        let read = kernel();
        if let (Ok(read), true) = (usize::try_from(read), spoil)
            && read > 0
        {
            // SAFETY: the kernel has just written so many bytes there.
            unsafe { *to.cast::<u8>().add(read / 2) ^= 0x10 };
        }
        read
    });
    size(read.unwrap_or_else(failed))
}

#[unsafe(no_mangle)]
extern "C" fn read(file: c_int, to: *mut c_void, count: size_t) -> ssize_t {
    read_by(file, to, || kernel!(SYS_read, file, to, count))
}

#[unsafe(no_mangle)]
extern "C" fn pread(file: c_int, to: *mut c_void, count: size_t, at: off_t) -> ssize_t {
    read_by(file, to, || kernel!(SYS_pread64, file, to, count, at))
}

#[unsafe(no_mangle)]
extern "C" fn pread64(file: c_int, to: *mut c_void, count: size_t, at: off_t) -> ssize_t {
    pread(file, to, count, at)
}

fn write_at(
    file: c_int,
    from: *const c_void,
    count: size_t,
    at: impl FnOnce() -> Option<u64>,
    kernel: impl FnOnce() -> c_long,
) -> ssize_t {
    let bytes = if count == 0 {
        &[]
    } else {
        // SAFETY: what C promises of what is to be written.
        unsafe { std::slice::from_raw_parts(from.cast::<u8>(), count) }
    };
    size(disk::write(file, at, bytes, kernel).unwrap_or_else(failed))
}

#[unsafe(no_mangle)]
extern "C" fn write(file: c_int, from: *const c_void, count: size_t) -> ssize_t {
    let kernel = || kernel!(SYS_write, file, from, count);
    write_at(file, from, count, || position(file), kernel)
}

#[unsafe(no_mangle)]
extern "C" fn pwrite(file: c_int, from: *const c_void, count: size_t, at: off_t) -> ssize_t {
    let kernel = || kernel!(SYS_pwrite64, file, from, count, at);
    write_at(file, from, count, || place(at), kernel)
}

#[unsafe(no_mangle)]
extern "C" fn pwrite64(file: c_int, from: *const c_void, count: size_t, at: off_t) -> ssize_t {
    pwrite(file, from, count, at)
}

#[unsafe(no_mangle)]
extern "C" fn ftruncate(file: c_int, size: off_t) -> c_int {
    let kernel = || kernel!(SYS_ftruncate, file, size);
    let size = usize::try_from(size).unwrap_or(0);
    int(disk::truncate(file, size, kernel).unwrap_or_else(failed))
}

#[unsafe(no_mangle)]
extern "C" fn ftruncate64(file: c_int, size: off_t) -> c_int {
    ftruncate(file, size)
}

#[unsafe(no_mangle)]
extern "C" fn fsync(file: c_int) -> c_int {
    let kernel = || kernel!(SYS_fsync, file);
    int(disk::sync(file, kernel).unwrap_or_else(failed))
}

#[unsafe(no_mangle)]
extern "C" fn fdatasync(file: c_int) -> c_int {
    let kernel = || kernel!(SYS_fdatasync, file);
    int(disk::sync(file, kernel).unwrap_or_else(failed))
}

#[unsafe(no_mangle)]
extern "C" fn rename(from: *const c_char, to: *const c_char) -> c_int {
    const HERE: c_int = libc::AT_FDCWD;
    let kernel = || kernel!(SYS_renameat2, HERE, from, HERE, to, 0);
    // SAFETY: what C promises of paths.
    let (from, to) = unsafe { (text(from), text(to)) };
    int(disk::rename(from, to, kernel).unwrap_or_else(failed))
}

#[unsafe(no_mangle)]
extern "C" fn unlinkat(at: c_int, path: *const c_char, flags: c_int) -> c_int {
    let kernel = || kernel!(SYS_unlinkat, at, path, flags);
    // SAFETY: what C promises of a path.
    let place = At(at, unsafe { text(path) });
    int(disk::remove(place, kernel).unwrap_or_else(failed))
}

#[unsafe(no_mangle)]
extern "C" fn unlink(path: *const c_char) -> c_int {
    unlinkat(libc::AT_FDCWD, path, 0)
}

#[unsafe(no_mangle)]
extern "C" fn rmdir(path: *const c_char) -> c_int {
    unlinkat(libc::AT_FDCWD, path, libc::AT_REMOVEDIR)
}

#[unsafe(no_mangle)]
extern "C" fn mkdir(path: *const c_char, mode: mode_t) -> c_int {
    let kernel = || kernel!(SYS_mkdirat, libc::AT_FDCWD, path, mode);
    // SAFETY: what C promises of a path.
    let place = At(libc::AT_FDCWD, unsafe { text(path) });
    int(disk::make_directory(place, kernel).unwrap_or_else(failed))
}
