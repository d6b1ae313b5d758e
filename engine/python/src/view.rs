//! The page in a browser.

use std::net::{Ipv4Addr, SocketAddr};
use std::sync::{Arc, Mutex, PoisonError};

use pyo3::prelude::*;
use pyo3::types::PyTuple;
use streamsplat::open::StillFile;
use streamsplat::scene;
use streamsplat::still::Still;
use streamsplat::stream::Workers;
use streamsplat::view::{Recorded, Server, Source, StillSource};

use crate::failure::{failed, wrong};

/// A page that is served on the loopback address until it is closed or dropped; a context manager.
#[pyclass(frozen, module = "streamsplat_cpu")]
pub struct Viewer {
    server: Mutex<Option<Server>>,
    url: String,
}

impl Viewer {
    fn start(source: Arc<dyn Source>, port: u16) -> PyResult<Self> {
        let address = SocketAddr::from((Ipv4Addr::LOCALHOST, port));
        let server = Server::start(address, &[], source).map_err(failed)?;
        let url = format!("http://{}/", server.address());
        Ok(Self { server: Mutex::new(Some(server)), url })
    }

    /// Opens the page of a scene in time.
    pub fn moving(title: String, scene: scene::Scene, workers: &Workers, port: u16) -> PyResult<Self> {
        Self::start(Arc::new(Recorded::new(title, scene, workers.clone())), port)
    }

    /// Opens the page of a still scene.
    pub fn still(title: String, still: Still, format: &'static str, workers: &Workers, port: u16) -> PyResult<Self> {
        let path = title.clone().into();
        let file = StillFile { path, format, bytes: 0, blake3: String::new(), still, in_time: None, notes: Vec::new() };
        let source = StillSource::new(title, file, workers.clone()).map_err(wrong)?;
        Self::start(Arc::new(source), port)
    }
}

#[pymethods]
impl Viewer {
    /// Address of the page.
    #[getter]
    pub fn url(&self) -> &str {
        &self.url
    }

    /// Stops the server.
    fn close(&self, py: Python<'_>) {
        py.detach(|| drop(self.server.lock().unwrap_or_else(PoisonError::into_inner).take()));
    }

    fn __enter__(this: PyRef<'_, Self>) -> PyRef<'_, Self> {
        this
    }

    #[pyo3(signature = (*_exception))]
    fn __exit__(&self, py: Python<'_>, _exception: &Bound<'_, PyTuple>) -> bool {
        self.close(py);
        false
    }

    fn __repr__(&self) -> String {
        let open = self.server.lock().unwrap_or_else(PoisonError::into_inner).is_some();
        if open { format!("Viewer({})", self.url) } else { "Viewer(closed)".to_owned() }
    }
}
