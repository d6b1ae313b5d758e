//! The names for which a server answers.

use std::net::{IpAddr, SocketAddr};

/// The names of a server that are allowed in the `Host` header of requests.
///
/// A foreign web page can make its own name resolve to the address of this server (DNS rebinding). It could then read
/// the browser's requests to that name. Those requests carry the foreign name, so only allowed names are accepted;
/// addresses and `localhost` cannot be redirected like that.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Hosts {
    loopback: bool,
    names: Vec<String>,
}

impl Hosts {
    /// Names of a server that listens on `address`: loopback addresses if it is one of them, otherwise all addresses;
    /// in both cases `localhost` and these `names`.
    pub fn of(address: IpAddr, names: &[String]) -> Hosts {
        Hosts { loopback: address.is_loopback(), names: names.to_vec() }
    }

    /// Returns true if requests may use this host name, with or without a port.
    pub fn contain(&self, host: &str) -> bool {
        let allowed = |address: IpAddr| !self.loopback || address.is_loopback();
        if let Ok(address) = host.parse::<SocketAddr>() {
            return allowed(address.ip());
        }
        let bare = host.strip_prefix('[').and_then(|h| h.strip_suffix(']')).unwrap_or(host);
        if let Ok(address) = bare.parse::<IpAddr>() {
            return allowed(address);
        }
        let name = match host.rsplit_once(':') {
            Some((name, port)) if port.bytes().all(|digit| digit.is_ascii_digit()) => name,
            _ => host,
        };
        name.eq_ignore_ascii_case("localhost") || self.names.iter().any(|known| known.eq_ignore_ascii_case(name))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_refused_unless_they_were_allowed() {
        let names = ["box.example".to_owned()];
        let loopback = Hosts::of(IpAddr::from([127, 0, 0, 1]), &names);
        let open = Hosts::of(IpAddr::from([0, 0, 0, 0]), &names);
        for host in [
            "evil.example",
            "evil.example:8080",
            "127.0.0.1.evil.example",
            "box.example.evil",
            "localhost.evil:1",
            "",
            ":80",
        ] {
            assert!(!loopback.contain(host) && !open.contain(host), "{host}");
        }
        for host in [
            "LOCALHOST:1",
            "localhost",
            "127.0.0.1",
            "127.8.9.1:5",
            "[::1]",
            "[::1]:3",
            "box.example",
            "Box.Example:8707",
        ] {
            assert!(loopback.contain(host) && open.contain(host), "{host}");
        }
        for host in ["10.0.0.1", "192.168.1.7:8707", "[fe80::1]:80"] {
            assert!(!loopback.contain(host) && open.contain(host), "{host}");
        }
    }
}
