// Behind the text of a sequence: runs it. `start`: the words of the first record, and where the
// tasks lie.
}  // namespace
}  // namespace device

extern "C" void run_sequence(const uint64_t* start, uint64_t* table, void* record, uint32_t* flag,
                             unsigned blocks, unsigned threads, unsigned seed) {
  gridDim.x = blocks;
  blockDim.x = threads;
  const device::sequence_start first{start[0], start[1]};
  device::device_sink sink{};
  sink.record = static_cast<device::device_error*>(record);
  sink.flag = flag;
  g_thread = [&] {
    device::novaphy_main(first, reinterpret_cast<device::uint64_t*>(table), 0, sink);
  };
  run_all(seed);
}
