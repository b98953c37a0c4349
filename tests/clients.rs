//! Many clients at once, HTTP and gRPC mixed, and `kill -9` in the middle: every answer is recorded, and the whole is checked
//! against a model that does one change after the other.
//!
//! ```text
//!   16 clients ── changes, reads, listings ──> a real server, killed and started again on its data
//!        └─ Event: when sent, when answered, what was said ──> per scene: a place in the order of the seqs for each of them
//! ```

use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tokio::sync::{mpsc, watch};
use tokio_stream::StreamExt;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Status;
use tonic::transport::{Channel, Endpoint};
use tonic_types::StatusExt;
use union3d::engine::recount;
use union3d::geometry::{Edge, Place};
use union3d::wire::convert::{self, Exact, Settings, SettingsDocument, mass_properties};
use union3d::wire::proto::union_service_client::UnionServiceClient;
use union3d::wire::proto::{
    ApplyChangeRequest, AuditSceneRequest, Change, CreateSceneRequest, GetHistoryRequest,
    GetMassPropertiesRequest, ListCubesRequest, MassProperties, Outcome, SceneSettings,
    StreamChangesRequest, StreamOpening, StreamedChange, stream_changes_request as request,
    stream_changes_response as response,
};

#[path = "oracle/random.rs"]
mod random;

use random::Random;

const CLIENTS: u64 = 16;
const EDGE: i64 = 3;

/// The first is everybody's; of the others each belongs to a third of the clients.
const SCENES: [&str; 4] = ["shared", "one", "two", "three"];

/// Cubes that all clients insert and delete.
const POOL: u64 = 40;

/// Answers before the server is killed, and after it was started again.
const ANSWERS: usize = 1_500;

/// Changes that a streaming client sends ahead.
const AHEAD: usize = 8;

const PATIENCE: Duration = Duration::from_secs(120);

type Client = UnionServiceClient<Channel>;

/// A server process; killed when dropped.
struct Server(Child);

#[derive(Clone, PartialEq, Debug)]
struct Addresses {
    http: String,
    grpc: String,
}

impl Server {
    fn start(data: &Path) -> (Self, Addresses) {
        union3d::wire::trust::install_provider();
        let mut process = Command::new(env!("CARGO_BIN_EXE_union3d"))
            .args(["serve", "--http", "127.0.0.1:0", "--grpc", "127.0.0.1:0"])
            .args(["--log-filter", "warn,tower_http=off", "--data"])
            .arg(data)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        let stdout = process.stdout.take().unwrap();
        BufReader::new(stdout).read_line(&mut line).unwrap();
        let words: Vec<_> = line.split_whitespace().collect();
        let ["listening", http, grpc] = words[..] else {
            panic!("{line:?}");
        };
        let addresses = Addresses {
            http: http.to_owned(),
            grpc: grpc.replace("grpc://", "http://"),
        };
        (Self(process), addresses)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _dead = self.0.kill();
        let _dead = self.0.wait();
    }
}

async fn ready(addresses: &Addresses) {
    let deadline = Instant::now() + PATIENCE;
    loop {
        let answer = reqwest::get(format!("{}/readyz", addresses.http)).await;
        if answer.unwrap().status().is_success() {
            return;
        }
        assert!(Instant::now() < deadline, "never ready");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

async fn connect(addresses: &Addresses) -> Option<Client> {
    let endpoint = Endpoint::from_shared(addresses.grpc.clone()).unwrap();
    Some(UnionServiceClient::new(endpoint.connect().await.ok()?))
}

/// What one change asks for.
#[derive(Clone, PartialEq, Debug)]
struct Asked {
    delete: Vec<u64>,
    insert: Vec<u64>,
}

/// What is compared of the totals: exact integers.
#[derive(Clone, PartialEq, Debug)]
struct Totals {
    cubes: u64,
    euler_characteristic: i64,
    vertices: i64,
    exact: Exact,
}

/// What was answered.
#[derive(Clone, Debug)]
enum Answered {
    Change {
        seq: u64,
        /// Inserted, deleted, unchanged.
        counts: [u64; 3],
        totals: Totals,
    },
    Totals(u64, Totals),
    Cubes(u64, BTreeSet<u64>),
}

impl Answered {
    fn seq(&self) -> u64 {
        match self {
            Self::Change { seq, .. } | Self::Totals(seq, _) | Self::Cubes(seq, _) => *seq,
        }
    }
}

/// One request and what came of it.
#[derive(Debug)]
struct Event {
    scene: usize,
    client: u64,
    asked: Option<Asked>,
    sent: Instant,
    /// None when the server died before it answered.
    answered: Option<(Instant, Answered)>,
}

/// Lower corner of a cube, a function of its id: crowded.
fn corner(id: u64) -> [i64; 3] {
    let mixed = (id.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 20) as i64;
    [mixed % 11, (mixed / 11) % 7, (mixed / 77) % 9]
}

/// A client and all it remembers.
struct Actor {
    number: u64,
    random: Random,
    addresses: watch::Receiver<Option<Addresses>>,
    answers: Arc<AtomicUsize>,
    events: Vec<Event>,
    http: reqwest::Client,
    /// Changes so far: each has a cube of its own, so that no two of them do the same.
    changes: u64,
    /// The own cube of the newest change, by scene.
    own: [Option<u64>; SCENES.len()],
}

impl Actor {
    fn scene(&mut self) -> usize {
        match self.random.below(2) {
            0 => 0,
            _ => 1 + usize::try_from(self.number % 3).unwrap(),
        }
    }

    /// Some cubes of the pool in and out, and mostly an own one in for the last own one.
    fn ask(&mut self, scene: usize) -> Asked {
        let mut asked = Asked {
            delete: vec![],
            insert: vec![],
        };
        let mut named = BTreeSet::new();
        for _ in 0..self.random.within(0, 5) {
            let id = self.random.below(POOL);
            if named.insert(id) {
                match self.random.below(2) {
                    0 => asked.delete.push(id),
                    _ => asked.insert.push(id),
                }
            }
        }
        if self.random.below(8) > 0 {
            self.changes += 1;
            let own = (self.number + 1) << 32 | self.changes;
            asked.delete.extend(self.own[scene].replace(own));
            asked.insert.push(own);
        }
        asked
    }

    /// The address of the server that is up now, other than `before`.
    async fn address(&mut self, before: Option<&Addresses>) -> Option<Addresses> {
        loop {
            let now = self.addresses.borrow_and_update().clone();
            if now.is_some() && now.as_ref() != before {
                return now;
            }
            self.addresses.changed().await.ok()?;
        }
    }

    fn note(
        &mut self,
        scene: usize,
        asked: Option<Asked>,
        sent: Instant,
        answered: Option<Answered>,
    ) {
        if answered.is_some() {
            self.answers.fetch_add(1, Ordering::Relaxed);
        }
        self.events.push(Event {
            scene,
            client: self.number,
            asked,
            sent,
            answered: answered.map(|answered| (Instant::now(), answered)),
        });
    }

    /// Works until there is no server any more.
    async fn run(mut self) -> Vec<Event> {
        let mut before = None;
        let mut lost: Option<(usize, Asked)> = None;
        while let Some(addresses) = self.address(before.as_ref()).await {
            // A change whose answer was lost is sent again, as a client would.
            lost = match self.number % 4 {
                0 | 1 => self.over_http(&addresses, lost.take()).await,
                2 => self.over_grpc(&addresses, lost.take()).await,
                _ => {
                    self.over_a_stream(&addresses).await;
                    None
                }
            };
            before = Some(addresses);
        }
        self.events
    }

    /// Answers the change whose answer was lost when the server died.
    async fn over_http(
        &mut self,
        addresses: &Addresses,
        mut again: Option<(usize, Asked)>,
    ) -> Option<(usize, Asked)> {
        loop {
            let scene = self.scene();
            let kind = self.random.below(6);
            let url = |scene: usize, rest: &str| {
                format!("{}/v1/scenes/{}{rest}", addresses.http, SCENES[scene])
            };
            if again.is_none() && kind == 0 {
                let sent = Instant::now();
                let answer = get(self.http.get(url(scene, "/mass-properties"))).await;
                let (_, text) = answer?;
                let body: Value = serde_json::from_str(&text).unwrap();
                let answered = Answered::Totals(body["seq"].as_u64().unwrap(), from_json(&body));
                self.note(scene, None, sent, Some(answered));
            } else if again.is_none() && kind == 1 {
                let sent = Instant::now();
                let listing = self.http.get(url(scene, "/cubes"));
                let answer = get(listing.header("accept", "application/x-ndjson")).await;
                let (tag, text) = answer?;
                let seq = tag.trim_matches('"').rsplit('-').next().unwrap();
                let lines = text.lines().map(|line| {
                    let line: Value = serde_json::from_str(line).unwrap();
                    line["insert"]["id"].as_u64().unwrap()
                });
                let answered = Answered::Cubes(seq.parse().unwrap(), lines.collect());
                self.note(scene, None, sent, Some(answered));
            } else {
                let (scene, asked) = again.take().unwrap_or_else(|| (scene, self.ask(scene)));
                let cube = |id: &u64| json!({"id": id, "at": corner(*id)});
                let cubes: Vec<_> = asked.insert.iter().map(cube).collect();
                let body = json!({"delete": asked.delete, "insert": cubes});
                let sent = Instant::now();
                let answer = get(self.http.post(url(scene, "/changes")).json(&body)).await;
                let answered = answer.map(|(_, text)| {
                    let body: Value = serde_json::from_str(&text).unwrap();
                    let number = |name: &str| body[name].as_u64().unwrap();
                    Answered::Change {
                        seq: number("seq"),
                        counts: ["inserted", "deleted", "unchanged"].map(number),
                        totals: from_json(&body["mass_properties"]),
                    }
                });
                let died = answered.is_none();
                self.note(scene, Some(asked.clone()), sent, answered);
                if died {
                    return Some((scene, asked));
                }
            }
        }
    }

    /// Answers the change whose answer was lost when the server died.
    async fn over_grpc(
        &mut self,
        addresses: &Addresses,
        mut again: Option<(usize, Asked)>,
    ) -> Option<(usize, Asked)> {
        let Some(mut client) = connect(addresses).await else {
            return again;
        };
        loop {
            let scene = self.scene();
            let name = || SCENES[scene].to_owned();
            let kind = self.random.below(6);
            if again.is_none() && kind == 0 {
                let sent = Instant::now();
                let request = GetMassPropertiesRequest {
                    scene: name(),
                    ..Default::default()
                };
                let answer = died(client.get_mass_properties(request).await)?;
                let shown = answer.into_inner().mass_properties.unwrap();
                let answered = Answered::Totals(shown.seq, from_message(shown));
                self.note(scene, None, sent, Some(answered));
            } else if again.is_none() && kind == 1 {
                let sent = Instant::now();
                let request = ListCubesRequest { scene: name() };
                let mut pieces = died(client.list_cubes(request).await)?.into_inner();
                let (mut seqs, mut cubes) = (BTreeSet::new(), BTreeSet::new());
                while let Some(piece) = pieces.next().await {
                    let piece = died(piece)?;
                    seqs.insert(piece.seq);
                    cubes.extend(piece.cubes.unwrap().insert_id);
                }
                // An empty scene is listed without a word.
                if let Some(seq) = seqs.pop_first() {
                    assert!(seqs.is_empty(), "a listing of two states");
                    self.note(scene, None, sent, Some(Answered::Cubes(seq, cubes)));
                }
            } else {
                let (scene, asked) = again.take().unwrap_or_else(|| (scene, self.ask(scene)));
                let request = ApplyChangeRequest {
                    scene: SCENES[scene].to_owned(),
                    change: Some(message(&asked)),
                    ..Default::default()
                };
                let sent = Instant::now();
                let answer = died(client.apply_change(request).await);
                let answered = answer.map(|answer| outcome(answer.into_inner().outcome));
                let died = answered.is_none();
                self.note(scene, Some(asked.clone()), sent, answered);
                if died {
                    return Some((scene, asked));
                }
            }
        }
    }

    /// Streams into one scene, some changes ahead, until the server dies.
    async fn over_a_stream(&mut self, addresses: &Addresses) {
        let scene = self.scene();
        let Some(mut client) = connect(addresses).await else {
            return;
        };
        let (to, receiver) = mpsc::channel(AHEAD);
        let opening = request::Message::Opening(StreamOpening {
            scene: SCENES[scene].to_owned(),
            ..Default::default()
        });
        let wrap = |message| StreamChangesRequest {
            message: Some(message),
        };
        to.send(wrap(opening)).await.unwrap();
        let answers = client.stream_changes(ReceiverStream::new(receiver)).await;
        let Some(answers) = died(answers) else {
            return;
        };
        let mut answers = answers.into_inner();
        let mut ahead: VecDeque<(u64, Asked, Instant)> = VecDeque::new();
        let mut tag = 0;
        loop {
            while ahead.len() < AHEAD {
                tag += 1;
                let asked = self.ask(scene);
                let change = request::Message::Change(StreamedChange {
                    tag,
                    change: Some(message(&asked)),
                    idempotency_key: None,
                });
                ahead.push_back((tag, asked, Instant::now()));
                if to.send(wrap(change)).await.is_err() {
                    break;
                }
            }
            let answer = answers.next().await.and_then(died);
            match answer.map(|answer| answer.message.unwrap()) {
                Some(response::Message::Opened(_)) => {}
                Some(response::Message::Acknowledged(one)) => {
                    let (tag, asked, sent) = ahead.pop_front().unwrap();
                    assert_eq!(one.tag, tag, "in order");
                    self.note(scene, Some(asked), sent, Some(outcome(one.outcome)));
                }
                Some(response::Message::Refused(refused)) => panic!("{refused:?}"),
                None => break,
            }
        }
        for (_, asked, sent) in ahead {
            self.note(scene, Some(asked), sent, None);
        }
    }
}

/// The entity tag and the text of a good answer; none when the server has died.
async fn get(request: reqwest::RequestBuilder) -> Option<(String, String)> {
    let answer = request.send().await.ok()?;
    let status = answer.status();
    let tag = answer.headers().get("etag");
    let tag = tag.map_or(String::new(), |tag| tag.to_str().unwrap().to_owned());
    let text = answer.text().await.ok()?;
    assert!(status.is_success(), "{status}: {text}");
    Some((tag, text))
}

/// A good answer; none when the server has died. A refusal has details, a broken connection has none.
fn died<T>(answer: Result<T, Status>) -> Option<T> {
    let check = |status: &Status| {
        let details = status.get_error_details();
        assert!(details.error_info().is_none(), "{status:?}");
    };
    answer.inspect_err(check).ok()
}

fn message(asked: &Asked) -> Change {
    let column = |axis: usize| {
        let coordinates = asked.insert.iter().map(|id| corner(*id)[axis] as i32);
        coordinates.collect()
    };
    Change {
        delete: asked.delete.clone(),
        insert_id: asked.insert.clone(),
        x: column(0),
        y: column(1),
        z: column(2),
        ..Change::default()
    }
}

fn outcome(outcome: Option<Outcome>) -> Answered {
    let outcome = outcome.unwrap();
    Answered::Change {
        seq: outcome.seq,
        counts: [outcome.inserted, outcome.deleted, outcome.unchanged],
        totals: from_message(outcome.mass_properties.unwrap()),
    }
}

fn from_json(shown: &Value) -> Totals {
    Totals::of(serde_json::from_value(shown.clone()).unwrap())
}

fn from_message(shown: MassProperties) -> Totals {
    Totals::of(shown.try_into().unwrap())
}

/// The model: a set of cubes.
#[derive(Clone, Default)]
struct Model(BTreeSet<u64>);

impl Model {
    /// Inserted, deleted and unchanged.
    fn apply(&mut self, asked: &Asked) -> [u64; 3] {
        let [mut inserted, mut deleted, mut unchanged] = [0; 3];
        for id in &asked.delete {
            let count = if self.0.remove(id) {
                &mut deleted
            } else {
                &mut unchanged
            };
            *count += 1;
        }
        for id in &asked.insert {
            let count = if self.0.insert(*id) {
                &mut inserted
            } else {
                &mut unchanged
            };
            *count += 1;
        }
        [inserted, deleted, unchanged]
    }

    /// Its totals, counted from nothing.
    fn totals(&self, settings: &Settings) -> Totals {
        let edge = Edge::new(EDGE).unwrap();
        let places = self
            .0
            .iter()
            .map(|id| Place::new(corner(*id), edge).unwrap());
        let shown = mass_properties(None, None, &recount(edge, None, places), settings);
        Totals::of(shown)
    }
}

impl Totals {
    fn of(shown: convert::MassProperties) -> Self {
        let integers = shown.integers;
        Self {
            cubes: shown.cubes,
            euler_characteristic: integers.euler_characteristic,
            vertices: integers.vertices.total,
            exact: integers.exact,
        }
    }
}

/// A row of the history as the server tells it at the end.
struct Row {
    counts: [u64; 2],
    totals: Totals,
}

/// Gives every event of a scene its place in the order of the seqs, or fails.
fn check(scene: &str, events: &[Event], rows: &[Row], last: &BTreeSet<u64>) {
    let settings = Settings::check(&SettingsDocument {
        steps_per_unit: 1.0,
        ..SettingsDocument::with_edge(EDGE as f64)
    })
    .unwrap();
    let mut by_seq: BTreeMap<u64, Vec<&Event>> = BTreeMap::new();
    for event in events {
        if let Some((_, answered)) = &event.answered {
            by_seq.entry(answered.seq()).or_default().push(event);
        }
    }
    let newest = rows.len() as u64;
    let greatest = by_seq.last_key_value().map_or(0, |(seq, _)| *seq);
    assert!(
        greatest <= newest,
        "{scene}: seq {greatest} was answered and is lost"
    );
    let known = known_before(events);
    // A change whose answer was lost may be there, whole, once.
    let unanswered: Vec<&Event> = events
        .iter()
        .filter(|event| event.answered.is_none() && event.asked.is_some())
        .collect();
    // For every seq that nobody was told, those that may have taken it.
    let mut untold: Vec<Vec<usize>> = Vec::new();
    // Who was told which seq.
    let mut took: HashMap<*const Event, u64> = HashMap::new();
    let mut model = Model::default();
    let mut totals = model.totals(&settings);
    for seq in 0..=newest {
        let here = by_seq.get(&seq).map_or(&[][..], |events| events);
        let mut taker = None;
        if seq > 0 {
            let row = &rows[usize::try_from(seq - 1).unwrap()];
            let takes = |event: &&&Event| {
                let counts = model.clone().apply(event.asked.as_ref().unwrap());
                let answered = match &event.answered {
                    Some((_, Answered::Change { counts, .. })) => Some(*counts),
                    _ => None,
                };
                counts[..2] == row.counts
                    && counts[..2] != [0, 0]
                    && answered.is_none_or(|answered| answered == counts)
            };
            let changes = here.iter().filter(|event| event.asked.is_some());
            let takers: Vec<&Event> = changes.filter(takes).copied().collect();
            assert!(takers.len() <= 1, "{scene}: seq {seq} was given twice");
            taker = takers.first().copied();
            if let Some(taker) = taker {
                model.apply(taker.asked.as_ref().unwrap());
                took.insert(taker, seq);
            } else {
                // One whose answer was lost and that was sent before the seq
                // was seen: the totals tell which. Several may have asked for
                // the same.
                let mut fitting = Vec::new();
                let mut found = None;
                for (number, event) in unanswered.iter().enumerate() {
                    if !takes(&event) || known[&std::ptr::from_ref(*event)] >= seq {
                        continue;
                    }
                    let mut after = model.clone();
                    after.apply(event.asked.as_ref().unwrap());
                    if after.totals(&settings) == row.totals {
                        fitting.push(number);
                        found = Some(after);
                    }
                }
                model = found.unwrap_or_else(|| panic!("{scene}: nobody asked for seq {seq}"));
                untold.push(fitting);
            }
            totals = model.totals(&settings);
            assert_eq!(totals, row.totals, "{scene}: the totals of seq {seq}");
        }
        for event in here {
            let who = || format!("{scene}, seq {seq}, client {}: {event:?}", event.client);
            match &event.answered.as_ref().unwrap().1 {
                Answered::Change {
                    counts,
                    totals: shown,
                    ..
                } => {
                    assert_eq!(*shown, totals, "{}", who());
                    if !taker.is_some_and(|taker| std::ptr::eq(taker, *event)) {
                        let found = model.clone().apply(event.asked.as_ref().unwrap());
                        assert_eq!(*counts, found, "{}", who());
                        assert_eq!(counts[..2], [0, 0], "{}", who());
                    }
                }
                Answered::Totals(_, shown) => assert_eq!(*shown, totals, "{}", who()),
                Answered::Cubes(_, cubes) => assert_eq!(*cubes, model.0, "{}", who()),
            }
        }
    }
    assert_eq!(*last, model.0, "{scene}: the cubes at the end");
    assert!(
        all_taken(&untold, unanswered.len()),
        "{scene}: one change is there twice"
    );
    // What was answered before something else was sent comes before it.
    for event in events {
        let known = known[&std::ptr::from_ref(event)];
        let in_order = match (took.get(&std::ptr::from_ref(event)), &event.answered) {
            (Some(seq), _) => known < *seq,
            (None, Some((_, answered))) => known <= answered.seq(),
            (None, None) => true,
        };
        assert!(in_order, "{scene}: {known} was answered before {event:?}");
    }
}

/// For every event the greatest seq answered before it was sent.
fn known_before(events: &[Event]) -> HashMap<*const Event, u64> {
    let mut answered: Vec<(Instant, u64)> = events
        .iter()
        .filter_map(|event| {
            let (at, answered) = event.answered.as_ref()?;
            Some((*at, answered.seq()))
        })
        .collect();
    answered.sort_unstable();
    let mut sent: Vec<&Event> = events.iter().collect();
    sent.sort_unstable_by_key(|event| event.sent);
    let mut before = answered.into_iter().peekable();
    let mut known = 0;
    let mut all = HashMap::new();
    for event in sent {
        while let Some((_, seq)) = before.next_if(|(at, _)| *at < event.sent) {
            known = known.max(seq);
        }
        all.insert(std::ptr::from_ref(event), known);
    }
    all
}

/// Whether each of the seqs can have a change of its own, of those that fit it
/// (a bipartite matching by augmenting paths).
fn all_taken(seqs: &[Vec<usize>], changes: usize) -> bool {
    fn take(
        seqs: &[Vec<usize>],
        seq: usize,
        of: &mut [Option<usize>],
        seen: &mut BTreeSet<usize>,
    ) -> bool {
        seqs[seq].iter().any(|&change| {
            if !seen.insert(change) {
                return false;
            }
            let free = of[change].is_none_or(|other| take(seqs, other, of, seen));
            if free {
                of[change] = Some(seq);
            }
            free
        })
    }
    let mut of = vec![None; changes];
    (0..seqs.len()).all(|seq| take(seqs, seq, &mut of, &mut BTreeSet::new()))
}

/// All rows of a scene's history, and its cubes at the end.
async fn told(client: &mut Client, scene: &str) -> (Vec<Row>, BTreeSet<u64>) {
    let request = GetHistoryRequest {
        scene: scene.to_owned(),
        ..Default::default()
    };
    let mut history = client.get_history(request).await.unwrap().into_inner();
    let mut rows = Vec::new();
    while let Some(row) = history.next().await {
        let row = row.unwrap();
        assert_eq!(
            row.seq,
            rows.len() as u64 + 1,
            "{scene}: no seq is left out"
        );
        rows.push(Row {
            counts: [row.inserted, row.deleted],
            totals: from_message(row.mass_properties.unwrap()),
        });
    }
    let request = ListCubesRequest {
        scene: scene.to_owned(),
    };
    let mut pieces = client.list_cubes(request).await.unwrap().into_inner();
    let mut cubes = BTreeSet::new();
    while let Some(piece) = pieces.next().await {
        cubes.extend(piece.unwrap().cubes.unwrap().insert_id);
    }
    let request = AuditSceneRequest {
        scene: scene.to_owned(),
    };
    let audit = client.audit_scene(request).await.unwrap().into_inner();
    assert_eq!(audit.cubes, cubes.len() as u64);
    (rows, cubes)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn sixteen_clients_see_one_history() {
    let seed: u64 = std::env::var("SEED").map_or(20_261, |seed| seed.parse().unwrap());
    println!("SEED={seed}");
    let directory = tempfile::tempdir().unwrap();
    let data = directory.path().join("data");
    let (server, addresses) = Server::start(&data);
    ready(&addresses).await;
    let mut client = connect(&addresses).await.unwrap();
    for scene in SCENES {
        let settings = SceneSettings {
            edge: EDGE as f64,
            steps_per_unit: Some(1),
            ..SceneSettings::default()
        };
        let request = CreateSceneRequest {
            scene: scene.to_owned(),
            settings: Some(settings),
            solids: None,
        };
        client.create_scene(request).await.unwrap();
    }
    let answers = Arc::new(AtomicUsize::new(0));
    let (up, addresses) = watch::channel(Some(addresses));
    let actors: Vec<_> = (0..CLIENTS)
        .map(|number| {
            let actor = Actor {
                number,
                random: Random::new(seed + number),
                addresses: addresses.clone(),
                answers: answers.clone(),
                events: Vec::new(),
                http: reqwest::Client::new(),
                changes: 0,
                own: [None; SCENES.len()],
            };
            tokio::spawn(actor.run())
        })
        .collect();
    let enough = async |count: usize| {
        let deadline = Instant::now() + PATIENCE;
        while answers.load(Ordering::Relaxed) < count {
            assert!(Instant::now() < deadline, "the server is too slow");
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    };
    enough(ANSWERS).await;
    // In the middle of everything.
    up.send_replace(None);
    drop(server);
    let (server, addresses) = Server::start(&data);
    ready(&addresses).await;
    let before = answers.load(Ordering::Relaxed);
    up.send_replace(Some(addresses));
    enough(before + ANSWERS).await;
    up.send_replace(None);
    drop(server);
    drop(up);
    let mut events: Vec<Vec<Event>> = SCENES.iter().map(|_| Vec::new()).collect();
    for actor in actors {
        for event in actor.await.unwrap() {
            events[event.scene].push(event);
        }
    }
    let (_server, addresses) = Server::start(&data);
    ready(&addresses).await;
    let mut client = connect(&addresses).await.unwrap();
    for (scene, events) in SCENES.iter().zip(&events) {
        let (rows, cubes) = told(&mut client, scene).await;
        let lost = events.iter().filter(|event| event.answered.is_none());
        println!(
            "{scene}: {} events, {} of them unanswered, {} seqs",
            events.len(),
            lost.count(),
            rows.len()
        );
        check(scene, events, &rows, &cubes);
    }
}

/// The check itself is checked: each wrong story is told from the right one.
#[test]
fn a_history_that_cannot_be_is_found_out() {
    let settings = Settings::check(&SettingsDocument {
        steps_per_unit: 1.0,
        ..SettingsDocument::with_edge(EDGE as f64)
    })
    .unwrap();
    let start = Instant::now();
    let at = |ms| start + Duration::from_millis(ms);
    let asked = |insert: &[u64]| Asked {
        delete: vec![],
        insert: insert.to_vec(),
    };
    let totals = |ids: &[u64]| Model(ids.iter().copied().collect()).totals(&settings);
    let change = |client, sent, answered, ids: &[u64], seq, all: &[u64]| Event {
        scene: 0,
        client,
        asked: Some(asked(ids)),
        sent: at(sent),
        answered: Some((
            at(answered),
            Answered::Change {
                seq,
                counts: [ids.len() as u64, 0, 0],
                totals: totals(all),
            },
        )),
    };
    let read = |sent, answered, seq, ids: &[u64]| Event {
        scene: 0,
        client: 9,
        asked: None,
        sent: at(sent),
        answered: Some((at(answered), Answered::Totals(seq, totals(ids)))),
    };
    let lost = |ids: &[u64]| Event {
        answered: None,
        ..change(5, 25, 0, ids, 0, &[])
    };
    let row = |count, ids: &[u64]| Row {
        counts: [count, 0],
        totals: totals(ids),
    };
    let right = || {
        let events = vec![
            change(1, 0, 10, &[1], 1, &[1]),
            change(2, 20, 30, &[2, 3], 2, &[1, 2, 3]),
            read(40, 50, 2, &[1, 2, 3]),
        ];
        let rows = vec![row(1, &[1]), row(2, &[1, 2, 3])];
        (events, rows, BTreeSet::from([1, 2, 3]))
    };
    type Story = (Vec<Event>, Vec<Row>, BTreeSet<u64>);
    let possible = |change: &dyn Fn(&mut Story)| {
        let mut story = right();
        change(&mut story);
        std::panic::catch_unwind(|| check("story", &story.0, &story.1, &story.2)).is_ok()
    };
    assert!(possible(&|_| {}));
    // A change without an answer may be there, but whole.
    assert!(possible(&|story| story.0.push(lost(&[4, 5]))));
    assert!(possible(&|story| {
        story.0[1].answered = None;
    }));
    assert!(!possible(&|story| {
        story.0[1].answered = None;
        story.1[1] = row(1, &[1, 2]);
        story.0.truncate(2);
        story.2.remove(&3);
    }));
    // Of two such that asked for the same, only one was sent before it was seen.
    let late = || Event {
        sent: at(60),
        ..lost(&[2, 3])
    };
    assert!(possible(&|story| {
        story.0[1].answered = None;
        story.0.insert(0, late());
    }));
    assert!(!possible(&|story| {
        story.0[1] = late();
    }));
    // An acknowledged change is lost.
    assert!(!possible(&|story| {
        story.0.truncate(2);
        story.1.pop();
        story.2 = BTreeSet::from([1]);
    }));
    // A read of what was never there, and one of what was long over.
    assert!(!possible(&|story| story.0.push(read(40, 50, 2, &[1, 2]))));
    assert!(!possible(&|story| story.0.push(read(40, 50, 1, &[1]))));
    assert!(possible(&|story| story.0.push(read(5, 50, 1, &[1]))));
    // A seq that nobody asked for, one given twice, and an order against time.
    assert!(!possible(&|story| {
        story.0.remove(1);
    }));
    assert!(!possible(&|story| story.0.push(change(
        3,
        20,
        30,
        &[2, 3],
        2,
        &[1, 2, 3]
    ))));
    assert!(!possible(&|story| story.0[0].sent = at(35)));
    // A lost change is there once, whichever of its places it took.
    assert!(all_taken(&[vec![0, 1], vec![0]], 2));
    assert!(!all_taken(&[vec![0], vec![0]], 2));
}
