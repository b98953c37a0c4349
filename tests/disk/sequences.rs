//! Calls that failed one after the other and lost something, or could have: each sequence by itself.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use union3d::engine::{Engine, Op};
use union3d::geometry::{CubeId, Effect, Place};
use union3d::log::{Log, Record, SceneLog, TEMPORARY_PREFIX};
use union3d::service::{
    Cubes, Motion, Operations, Readiness, SceneName, Seq, Service, ServiceConfig, Solids,
};
use union3d::wire::http::install_metrics;

use super::Random;
use super::disk::{Call, Disk, Event, Kind, Verdict, temporary};
use super::faults::fail_by;
use super::image::{Image, Reached};
use super::kinds::{Tried, edge};
use super::power::{assert_none, record};
use super::workload::{Client, KEEP, config, data, running, submission};

/// Lets the calls of `first..end` fail of those that `wanted` picks; all of them must come.
fn fail_range<K: Tried>(
    first: usize,
    end: usize,
    wanted: impl Fn(Call<'_>) -> bool + Send + 'static,
) -> Vec<String> {
    let met = Arc::new(AtomicUsize::new(0));
    let counted = met.clone();
    let failures = fail_by::<K>(1, move |call| {
        if wanted(call) && (first..end).contains(&counted.fetch_add(1, Ordering::Relaxed)) {
            return Verdict::Fail(libc::EIO);
        }
        Verdict::Pass
    });
    assert!(met.load(Ordering::Relaxed) >= end, "{first}..{end}");
    failures
}

fn syncs(call: Call<'_>, name: &str) -> bool {
    call.kind == Kind::Sync && call.path.file_name() == Some(OsStr::new(name))
}

/// The sync of a commit fails, and the one after it: what the commit has written can be read and is not on the disk, and later syncs
/// do not mind. SQLite takes it in when the scene is opened again, and would move it into the database; a power cut from then until the
/// write-ahead file was known to be empty found the database newer than that file, and an intact scene was refused.
fn fail_commits_and_what_follows<K: Tried>() {
    for first in 0..12 {
        let failures = fail_range::<K>(first, first + 2, |call| syncs(call, "scene.sqlite-wal"));
        assert_none(&failures);
    }
}

#[test]
fn what_a_failed_sync_left_in_memory_is_written_again_before_it_counts() {
    fail_commits_and_what_follows::<Cubes>();
    fail_commits_and_what_follows::<Solids>();
}

/// The sync of `scenes/` fails behind the rename by which a scene goes. The scene is not gone then, and has its name back, but who
/// knows which name is on the disk: what is acknowledged later was lost with the other.
#[test]
fn a_scene_whose_removal_failed_is_there_and_keeps_what_comes_later() {
    for removals in 1..3 {
        let mut removals_left = removals;
        let mut is_renamed = false;
        let failures = fail_by::<Cubes>(1, move |call| {
            let name = call.path.file_name().and_then(OsStr::to_str);
            let goes = format!("{TEMPORARY_PREFIX}remove");
            is_renamed |=
                call.kind == Kind::Rename && name.is_some_and(|name| name.starts_with(&goes));
            if is_renamed && removals_left > 0 && syncs(call, "scenes") {
                is_renamed = false;
                removals_left -= 1;
                return Verdict::Fail(libc::EIO);
            }
            Verdict::Pass
        });
        assert_none(&failures);
    }
}

/// A directory on the way to the data directory is made, and the sync of its name fails, once and again: at the next start it is there,
/// and durable all the same only if somebody syncs it.
#[test]
fn directories_on_the_way_are_durable_though_their_first_syncs_failed() {
    for directory in ["", "srv", "srv/machines"] {
        for times in 1..4 {
            let failures = fail_range::<Cubes>(0, times, move |call| {
                call.kind == Kind::Sync && call.path == Path::new(directory)
            });
            assert_none(&failures);
        }
    }
}

/// A record that inserts cubes at random places.
fn insertion(engine: &mut Engine, random: &mut Random, seq: u64, cubes: u64) -> Record {
    let inserted = (0..cubes).map(|index| {
        let corner = [0; 3].map(|_: i64| random.within(-1_000_000, 1_000_000));
        (
            CubeId(seq * 10_000 + index),
            Place::new(corner, edge()).unwrap(),
        )
    });
    let effect = Effect {
        deleted: Vec::new(),
        inserted: inserted.collect(),
    };
    engine.apply(&effect).unwrap();
    Record {
        seq: Seq(seq),
        at_ms: 1,
        effect,
        reverts_to: None,
        motion: Motion::default(),
        volume_removed: 0,
        totals: engine.totals(),
    }
}

/// A checkpoint moves only what nobody reads in the write-ahead file, and SQLite takes that for done without a sync of the database: the
/// next checkpoint syncs it all. When that sync fails, a third one would go on behind the first, and begin the file anew over pages that
/// are not on the disk.
#[test]
fn after_a_failed_checkpoint_everything_is_moved_anew() {
    let disk = Disk::new();
    let path = disk.path().join("scene");
    let mut random = Random::new(6);
    let mut engine = Engine::new(edge());
    let mut next = {
        let mut seq = 0;
        move |log: &mut SceneLog, cubes| {
            seq += 1;
            let record = insertion(&mut engine, &mut random, seq, cubes);
            log.append(&[record], &[]).unwrap();
        }
    };
    let mut log = SceneLog::create(&path, &Cubes::header(), KEEP).unwrap();
    let history = log.history().unwrap();
    next(&mut log, 3000);
    let reader = rusqlite::Connection::open(path.join("scene.sqlite")).unwrap();
    reader.execute_batch("BEGIN; SELECT * FROM head").unwrap();
    next(&mut log, 1);
    log.checkpoint().unwrap();
    drop(reader);
    disk.set_rule(|call| {
        if syncs(call, "scene.sqlite") {
            Verdict::Fail(libc::EIO)
        } else {
            Verdict::Pass
        }
    });
    assert!(log.checkpoint().is_err());
    disk.heal();
    drop(log);
    assert!(history.range().is_err(), "its connection is closed, too");
    let mut log = SceneLog::open(&path, KEEP).unwrap().0;
    log.replay(&mut |_| (), &mut |_| true).unwrap();
    next(&mut log, 1);
    let mut image = Image::new();
    for event in disk.events() {
        // Of what a failed sync has not written, nothing is there.
        image.apply_and_lose(&event);
    }
    let copy = temporary();
    image.write_to(copy.path(), &Reached::None);
    let (mut log, notices) = Log::<Cubes>::open(&copy.path().join("scene"), KEEP).unwrap();
    assert_eq!((log.seq(), notices), (Seq(3), Vec::new()));
    log.replay(&mut |_| (), &mut |_| true).unwrap();
}

/// A write-ahead file that was emptied is empty on the disk, too, before the next change is written into it: what was in it must
/// not come back beside a database that has gone on.
#[test]
fn an_emptied_write_ahead_file_is_synced_before_it_is_written_again() {
    let disk = Disk::new();
    let client = Client::<Cubes>::new(&disk, 3);
    let (events, _) = record(&disk, client, async |client| client.everything().await);
    let mut names = BTreeMap::new();
    let mut emptied = BTreeSet::new();
    let mut times = 0;
    for event in &events {
        match event {
            Event::Make { node, name, .. } => drop(names.insert(*node, name.clone())),
            Event::Truncate { node, size: 0 } if names[node] == "scene.sqlite-wal" => {
                emptied.insert(*node);
                times += 1;
            }
            Event::Sync(node) => drop(emptied.remove(node)),
            Event::Write { node, .. } => assert!(!emptied.contains(node), "{event:?}"),
            _ => {}
        }
    }
    assert!(times > 3, "{times}");
}

/// The write-ahead file cannot be moved into the database: nothing that was answered is lost by that, but the file would grow
/// without an end, and nobody would know.
#[test]
fn a_checkpoint_that_fails_stops_the_scene_and_is_told() {
    let disk = Disk::new();
    let metrics = install_metrics();
    let runtime = tokio::runtime::Builder::new_current_thread().build();
    runtime.unwrap().block_on(async {
        let config: ServiceConfig = config(disk.path());
        let pages_max = config.write_ahead_pages_max;
        let service = Service::start(config).unwrap();
        let name = SceneName::new("s").unwrap();
        let (scene, _) = service.create(&name, edge(), None, "{}").await.unwrap();
        disk.set_rule(|call| {
            if syncs(call, "scene.sqlite") {
                Verdict::Fail(libc::EIO)
            } else {
                Verdict::Pass
            }
        });
        let mut acknowledged = 0;
        loop {
            let place = Place::new([acknowledged, 0, 0], edge()).unwrap();
            let insertion = Op::Insert(CubeId(acknowledged.unsigned_abs()), place);
            let change = submission(Operations::Named(vec![insertion]));
            if scene.change(change).await.is_err() {
                break;
            }
            acknowledged += 1;
            assert!(acknowledged < 50, "the scene goes on and on");
        }
        assert!(acknowledged > 0);
        let told = loop {
            if let Readiness::Ready { troubled } = service.readiness()
                && let [(_, cause)] = &troubled[..]
                && !cause.contains("is being replayed")
            {
                break cause.clone();
            }
        };
        assert!(told.contains("disk I/O error"), "{told}");
        let counted = metrics.render();
        assert!(
            counted.contains("\nunion3d_checkpoint_failures_total "),
            "{counted}"
        );
        let write_ahead = data(disk.path()).join("scenes/s/scene.sqlite-wal");
        let pages = std::fs::metadata(write_ahead).unwrap().len() / 4096;
        assert!(pages < 2 * pages_max, "{pages} pages");
        disk.heal();
        let found = running::<Cubes>(&service, "s").published().unwrap();
        assert!(found.seq.0 >= acknowledged.unsigned_abs(), "{found:?}");
        service.shutdown().await;
    });
}
