#![no_main]

streamsplat_fuzz::target!("ksplat");
