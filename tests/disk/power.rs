//! The power fails after every single call of a workload that writes.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use union3d::log::Log;
use union3d::service::{Cubes, Offline, Solids};

use super::Random;
use super::disk::{Disk, Event, temporary};
use super::image::{Image, Reached};
use super::kinds::Tried;
use super::workload::{Acknowledged, Client, KEEP, Story, World, data};

/// Lets a client work and gives the record of what its disk saw.
pub(crate) fn record<K: Tried>(
    disk: &Disk,
    mut client: Client<'_, K>,
    work: impl AsyncFnOnce(&mut Client<'_, K>),
) -> (Vec<Event>, Story<K>) {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .unwrap();
    runtime.block_on(work(&mut client));
    (disk.events(), client.story)
}

/// What a recovery finds of a scene.
struct Found<K: Tried> {
    seq: u64,
    totals: K::Totals,
    definitions: usize,
}

/// What a recovery finds, as kept and as recounted.
fn recover<K: Tried>(root: &Path) -> Result<BTreeMap<String, Found<K>>, String> {
    let mut found = BTreeMap::new();
    let scenes = data(root).join("scenes");
    if !scenes.exists() {
        return Ok(found);
    }
    let offline = Offline::open(&data(root)).map_err(|error| error.to_string())?;
    for name in offline.scenes() {
        let audited = offline.audit(name, &mut |_| ());
        let name = name.as_str();
        let told = |error| format!("{name}: {error}");
        let audit = audited.map_err(told)?;
        if let Some(lost) = audit.notices.iter().find(|notice| notice.contains("lost")) {
            return Err(lost.clone());
        }
        let Some(audit) = K::audited(audit.audit) else {
            return Err(format!("{name}: of another kind"));
        };
        if !audit.is_equal() {
            return Err(format!("{name}: differs from a recount"));
        }
        let definitions = if K::DEFINES {
            let (log, _) = Log::<K>::open(&scenes.join(name), KEEP).map_err(told)?;
            K::defined(log.context())
        } else {
            0
        };
        let scene = Found {
            seq: audit.seq.0,
            totals: audit.kept,
            definitions,
        };
        found.insert(name.to_owned(), scene);
    }
    Ok(found)
}

/// The story of a client up to the moment when the power fails.
struct Moment<'a, K: Tried> {
    story: &'a Story<K>,
    mark: usize,
}

impl<K: Tried> Moment<'_, K> {
    /// What of a scene was acknowledged, and what is on its way.
    fn ends(&self, name: &str) -> [Option<Acknowledged>; 2] {
        let worlds = &self.story.worlds;
        let next = (self.mark + 1).min(worlds.len() - 1);
        [self.mark, next].map(|mark| worlds[mark].get(name).copied())
    }

    /// What was found as what had been acknowledged or was on its way; an error when it is neither.
    fn recognise(&self, found: &BTreeMap<String, Found<K>>) -> Result<World, String> {
        let worlds = self.story.worlds[self.mark..].iter().take(2);
        let names = worlds.flat_map(BTreeMap::keys).chain(found.keys());
        let mut recognised = World::new();
        for name in names {
            let ends = self.ends(name);
            let Some(scene) = found.get(name) else {
                if ends.contains(&None) {
                    continue;
                }
                return Err(format!("{name}: is not there, known is {ends:?}"));
            };
            let (seq, definitions) = (scene.seq, scene.definitions);
            let life = match ends {
                [Some(from), Some(to)]
                    if from.life == to.life
                        && (from.seq..=to.seq).contains(&seq)
                        && (from.definitions..=to.definitions).contains(&definitions) =>
                {
                    Some(from.life)
                }
                [Some(only), None] | [None, Some(only)]
                    if (seq, definitions) == (only.seq, only.definitions) =>
                {
                    Some(only.life)
                }
                _ => None,
            };
            let totals = life.and_then(|life| self.story.totals.get(&(name.clone(), life, seq)));
            let Some(life) = life.filter(|_| totals == Some(&scene.totals)) else {
                let [known, next] = ends;
                return Err(format!(
                    "{name}: found seq {seq} with {definitions} definitions, known is {known:?}, on its way {next:?}"
                ));
            };
            let acknowledged = Acknowledged {
                life,
                seq,
                definitions,
            };
            recognised.insert(name.clone(), acknowledged);
        }
        Ok(recognised)
    }
}

/// Shows every moment of a record that `wanted` picks: after which event, and what the disk is then.
fn moments<K: Tried>(
    events: &[Event],
    story: &Story<K>,
    random: &mut Random,
    mut wanted: impl FnMut(&Event) -> bool,
    mut visit: impl FnMut(&Image, &Moment<'_, K>, &mut Random, &dyn std::fmt::Display),
) {
    let mut image = Image::new();
    let mut mark = 0;
    for (index, event) in events.iter().enumerate() {
        image.apply(event, random);
        if let Event::Mark(next) = event {
            mark = *next;
        }
        if wanted(event) {
            let moment = Moment { story, mark };
            visit(
                &image,
                &moment,
                random,
                &format_args!("call {index}, {event:?}"),
            );
        }
    }
}

/// The failures of power cuts at those moments that `wanted` picks, in `ways` different ways each.
pub(crate) fn cut_all<K: Tried>(
    events: &[Event],
    story: &Story<K>,
    random: &mut Random,
    ways: usize,
    wanted: impl FnMut(&Event) -> bool,
) -> Vec<String> {
    let mut failures = Vec::new();
    moments(
        events,
        story,
        random,
        wanted,
        |image, moment, random, when| {
            let some = std::iter::repeat_with(|| Reached::some(random));
            let reached = [Reached::None, Reached::All].into_iter().chain(some);
            for reached in reached.take(ways) {
                let root = temporary();
                image.write_to(root.path(), &reached);
                let found = recover(root.path()).and_then(|found| moment.recognise(&found));
                if let Err(what) = found {
                    failures.push(format!("{when}, {reached:?} reached: {what}"));
                }
            }
        },
    );
    failures
}

#[track_caller]
pub(crate) fn assert_none(failures: &[String]) {
    let first = &failures[..failures.len().min(20)];
    assert!(
        failures.is_empty(),
        "{}:\n{}",
        failures.len(),
        first.join("\n")
    );
}

/// The power fails after every call of a workload, in `ways` different ways each.
fn cut_everywhere<K: Tried>(ways: usize, seed: u64) {
    let disk = Disk::new();
    let client = Client::<K>::new(&disk, seed);
    let (events, story) = record(&disk, client, async |client| client.everything().await);
    println!("{} calls", events.len());
    let failures = cut_all(&events, &story, &mut Random::new(seed), ways, |_| true);
    assert_none(&failures);
}

#[test]
fn nothing_acknowledged_is_lost_by_a_power_cut_after_any_call() {
    cut_everywhere::<Cubes>(4, 1);
}

#[test]
fn no_solid_that_was_acknowledged_is_lost_by_a_power_cut_after_any_call() {
    cut_everywhere::<Solids>(2, 1);
}

/// Every so many moments the power fails or only the process dies, a service goes on with what is left, and the power fails again at
/// any moment of that.
fn cut_twice<K: Tried>(step: usize, seed: u64) {
    let disk = Disk::new();
    let client = Client::<K>::new(&disk, seed);
    let (events, story) = record(&disk, client, async |client| client.everything().await);
    let random = &mut Random::new(seed);
    let first = usize::try_from(random.below(step as u64)).unwrap();
    let mut index = 0;
    let every = |_: &Event| {
        index += 1;
        index % step == first
    };
    let mut failures = Vec::new();
    moments(
        &events,
        &story,
        random,
        every,
        |image, moment, random, when| {
            let reached = match random.below(2) {
                0 => Reached::All,
                _ => Reached::some(random),
            };
            let disk = Disk::new();
            image.write_to(disk.path(), &reached);
            let copy = temporary();
            image.write_to(copy.path(), &reached);
            let world = recover(copy.path()).and_then(|found| moment.recognise(&found));
            let world = match world {
                Ok(world) => world,
                Err(what) => return failures.push(format!("{when}, {reached:?} reached: {what}")),
            };
            disk.make_durable();
            let client = Client::<K>::go_on(&disk, random.next(), world, story.totals.clone());
            let (events, story) = record(&disk, client, async |client| client.changes().await);
            let mut begun = false;
            let later = cut_all(&events, &story, random, 3, |event| {
                begun |= matches!(event, Event::Mark(_));
                begun
            });
            let told = |what| format!("{when}, {reached:?} reached; then {what}");
            failures.extend(later.into_iter().map(told));
        },
    );
    assert_none(&failures);
}

#[test]
fn nothing_acknowledged_is_lost_by_a_second_power_cut() {
    cut_twice::<Cubes>(150, 3);
}

#[test]
fn no_solid_that_was_acknowledged_is_lost_by_a_second_power_cut() {
    cut_twice::<Solids>(300, 3);
}

#[test]
#[ignore = "minutes: twice at any moment"]
fn nothing_acknowledged_is_lost_by_any_two_power_cuts() {
    cut_twice::<Cubes>(1, 4);
    cut_twice::<Solids>(1, 4);
}

/// All files of a directory but SQLite's shared index, which is written through memory and made anew after a crash.
fn files(directory: &Path, to: &mut BTreeMap<PathBuf, Vec<u8>>) {
    for entry in fs::read_dir(directory).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files(&path, to);
        } else if path
            .extension()
            .is_none_or(|extension| extension != "sqlite-shm")
        {
            to.insert(path.clone(), fs::read(path).unwrap());
        }
    }
}

/// No call is missed: what is made of the record is what is there.
#[test]
fn the_record_holds_all_that_reaches_the_files() {
    let disk = Disk::new();
    let client = Client::<Solids>::new(&disk, 2);
    let (events, _) = record(&disk, client, async |client| client.everything().await);
    let mut random = Random::new(2);
    let mut image = Image::new();
    for event in &events {
        image.apply(event, &mut random);
    }
    let copy = temporary();
    image.write_to(copy.path(), &Reached::All);
    let [there, recorded] = [disk.path(), copy.path()].map(|root| {
        let mut found = BTreeMap::new();
        files(root, &mut found);
        let found = found.into_iter();
        let found = found.map(|(path, bytes)| (path.strip_prefix(root).unwrap().to_owned(), bytes));
        found.collect::<BTreeMap<_, _>>()
    });
    assert!(there.len() > 4, "{:?}", there.keys());
    assert!(
        there.keys().eq(recorded.keys()),
        "{:?} {:?}",
        there.keys(),
        recorded.keys()
    );
    for (path, bytes) in there {
        assert!(bytes == recorded[&path], "{} differs", path.display());
    }
}
