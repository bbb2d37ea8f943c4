// Calls of oneDNN from threads of XLA.

#ifndef HA2G_PARALLEL_H_
#define HA2G_PARALLEL_H_

#include <omp.h>

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <exception>
#include <memory>
#include <mutex>
#include <string>

#include "oneapi/dnnl/dnnl.hpp"
#include "xla/ffi/api/ffi.h"

using Array = xla::ffi::Buffer<xla::ffi::F32>;
using Result = xla::ffi::ResultBuffer<xla::ffi::F32>;

inline const dnnl::engine& cpu() {
  static const dnnl::engine engine(dnnl::engine::kind::cpu, 0);
  return engine;
}

// Returns an array of float32 in the memory of XLA, as oneDNN takes it.
inline dnnl::memory view(const dnnl::memory::desc& desc, const float* values) {
  return dnnl::memory(desc, cpu(), const_cast<float*>(values));
}

// Returns a copy of an array in another layout.
inline dnnl::memory reordered(dnnl::stream& stream, const dnnl::memory& from, const dnnl::memory::desc& to) {
  dnnl::memory result(to, cpu());
  dnnl::memory source = from;
  dnnl::reorder(source, result).execute(stream, source, result);
  return result;
}

// A range of the batch.
struct Part {
  int64_t index, first, size;
};

// Returns into how many parts a batch is divided: one for each thread of XLA.
inline int64_t count_parts(const xla::ffi::ThreadPool& pool, int64_t batch) {
  return std::max<int64_t>(1, std::min(pool.num_threads(), batch));
}

// Divides a batch into parts of about the same size and calls work(part) for each, in this thread and in those threads
// of XLA that are free. oneDNN uses one thread within each call. This thread takes every part that no other has taken,
// so that it never waits for a thread that waits itself. Throws what `work` has thrown, after all parts have ended.
template <typename Work>
void for_each_part(xla::ffi::ThreadPool& pool, int64_t batch, const Work& work) {
  struct State {
    std::atomic<int64_t> next{0};
    std::mutex mutex;
    std::condition_variable changed;
    int64_t finished = 0;
    std::exception_ptr error;
  };
  const int64_t parts = count_parts(pool, batch);
  auto state = std::make_shared<State>();
  auto run = [state, parts, batch, &work] {
    for (int64_t i; (i = state->next++) < parts;) {
      const int64_t first = batch * i / parts;
      std::exception_ptr error;
      const int threads = omp_get_max_threads();
      omp_set_num_threads(1);
      try {
        work(Part{i, first, batch * (i + 1) / parts - first});
      } catch (...) {
        error = std::current_exception();
      }
      omp_set_num_threads(threads);
      std::lock_guard<std::mutex> lock(state->mutex);
      if (error) state->error = error;
      if (++state->finished == parts) state->changed.notify_all();
    }
  };
  for (int64_t i = 1; i < parts; ++i) {
    try {
      pool.Schedule(decltype(run)(run));
    } catch (...) {  // this thread takes the part
    }
  }
  run();
  std::unique_lock<std::mutex> lock(state->mutex);
  state->changed.wait(lock, [&] { return state->finished == parts; });
  if (state->error) std::rethrow_exception(state->error);
}

// Calls body() and returns what it throws as an error of XLA, which knows no exceptions.
template <typename Body>
xla::ffi::Error guarded(const Body& body) {
  try {
    body();
  } catch (const std::exception& error) {
    return xla::ffi::Error::Internal(std::string("oneDNN: ") + error.what());
  } catch (...) {
    return xla::ffi::Error::Internal("oneDNN: an unknown error");
  }
  return xla::ffi::Error::Success();
}

#endif  // HA2G_PARALLEL_H_
