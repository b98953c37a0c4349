//! How many connections there are, in all and of each address.

use std::collections::HashMap;
use std::net::{IpAddr, Ipv6Addr};
use std::sync::Arc;

use parking_lot::Mutex;

use super::meters;

/// The places that connections take.
pub(super) struct Places {
    all_max: usize,
    address_max: usize,
    taken: Mutex<Taken>,
}

#[derive(Default)]
struct Taken {
    all: usize,
    /// Those of each address that has any.
    by_address: HashMap<IpAddr, usize>,
}

/// The place of a connection, until this is dropped.
pub(super) struct Place {
    places: Arc<Places>,
    address: IpAddr,
}

impl Places {
    pub(super) fn new(all_max: usize, address_max: usize) -> Arc<Self> {
        Arc::new(Self {
            all_max,
            address_max,
            taken: Mutex::default(),
        })
    }

    /// A place for a connection from this address, if there is one.
    pub(super) fn take(self: &Arc<Self>, address: IpAddr) -> Option<Place> {
        let address = customer(address);
        let mut taken = self.taken.lock();
        if taken.all >= self.all_max {
            meters::refused("all");
            return None;
        }
        let of_address = taken.by_address.entry(address).or_default();
        if *of_address >= self.address_max {
            meters::refused("address");
            return None;
        }
        *of_address += 1;
        taken.all += 1;
        meters::opened();
        Some(Place {
            places: self.clone(),
            address,
        })
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut taken = self.places.taken.lock();
        taken.all -= 1;
        let of_address = taken.by_address.get_mut(&self.address);
        let of_address = of_address.expect("an address that has a connection is known");
        *of_address -= 1;
        if *of_address == 0 {
            taken.by_address.remove(&self.address);
        }
        meters::ended();
    }
}

/// What stands for all addresses that one customer is given together: of IPv6, those with the same first 64 bits.
fn customer(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V4(address) => address.into(),
        IpAddr::V6(address) => {
            let network = u128::from(address) >> 64 << 64;
            Ipv6Addr::from(network).into()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_bounded_in_all_and_by_address() {
        let places = Places::new(3, 2);
        let take = |address: &str| places.take(address.parse().unwrap());
        let first = take("10.0.0.1").unwrap();
        let _second = take("::ffff:10.0.0.1").unwrap();
        assert!(take("10.0.0.1").is_none(), "two of one address");
        let third = take("2001:db8::1").unwrap();
        assert!(take("10.0.0.2").is_none(), "three in all");
        drop(first);
        let _fourth = take("2001:db8::2").unwrap();
        drop(third);
        let _fifth = take("2001:db8:0:0:1::").unwrap();
        assert!(take("10.0.0.1").is_none(), "three in all");
    }

    #[test]
    fn addresses_of_one_customer_count_together() {
        let places = Places::new(9, 2);
        let take = |address: &str| places.take(address.parse().unwrap());
        let taken = (take("2001:db8::1"), take("2001:db8::2"));
        assert!(taken.0.is_some() && taken.1.is_some());
        assert!(take("2001:db8::3").is_none());
        assert!(take("2001:db8:0:1::3").is_some());
        drop(taken);
        assert!(take("2001:db8::3").is_some());
        assert!(places.taken.lock().by_address.is_empty(), "nothing is kept");
    }
}
