//! What is fuzzed: readers of bytes that anybody may have written. None may panic, and each keeps what it promises besides.

use std::sync::LazyLock;

use union3d::log::fuzzing;
use union3d::toolpath::{Interpreter, Options};
use union3d::wire::convert::Settings;
use union3d::wire::decode;
use union3d::wire::problem::{Code, Problem};

/// A reader under test: asserts that all is well with some bytes.
pub(crate) type Target = fn(&[u8]);

/// All of them, by name: that of their corpus too.
pub(crate) const TARGETS: [(&str, Target); 4] = [
    ("decode", decode_body),
    ("codec", fuzzing::codec),
    ("wal", fuzzing::wal),
    ("moves", moves),
];

const CUBES_MAX: usize = 50;

static SETTINGS: LazyLock<Settings> = LazyLock::new(|| {
    let body = br#"{"edge":3,"steps_per_unit":10,"rounding":"nearest","anchor":"center"}"#;
    decode::settings(body).expect("settings without a fault")
});

/// Bodies of requests. The first byte says of which: a change, a line, a message, settings, or a revert.
fn decode_body(bytes: &[u8]) {
    let Some((kind, body)) = bytes.split_first() else {
        return;
    };
    match kind {
        b'c' => change(body),
        b'l' => refused_well(decode::line(body, &SETTINGS)),
        b'm' => refused_well(decode::message(body, &SETTINGS, CUBES_MAX)),
        b's' => refused_well(decode::settings(body)),
        _ => refused_well(decode::revert(body)),
    }
}

/// A body that one of the two readers takes means the same to the other; only the slow one looks for ids at two places.
fn change(body: &[u8]) {
    let fast = decode::change(body, &SETTINGS, CUBES_MAX);
    let slow = decode::change_faults(body, &SETTINGS, CUBES_MAX);
    match (&fast, &slow) {
        (Ok(fast), Ok(slow)) => assert_eq!(format!("{fast:?}"), format!("{slow:?}")),
        (Err(fast), Ok(_)) => panic!("refused at first: {fast:?}"),
        (_, Err(slow)) => assert_ne!(slow.code(), Code::Internal),
    }
    refused_well(fast);
}

fn refused_well<T>(read: Result<T, Problem>) {
    if let Err(problem) = read {
        assert_ne!(problem.code(), Code::Internal, "{problem:?}");
    }
}

/// A program is run to its end or to its fault, and nothing comes after that.
fn moves(bytes: &[u8]) {
    let mut moves = Interpreter::new(bytes, Options::default());
    let mut has_failed = false;
    for event in moves.by_ref() {
        assert!(!has_failed, "something comes after an error");
        has_failed = event.is_err();
    }
    assert!(moves.next().is_none());
    assert!(moves.bytes() <= bytes.len() as u64);
}
