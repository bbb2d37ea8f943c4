// The two scans of a GRU: its states, and the gradients of the sums inside its gates (see gru_scan.py).
//
// Arrays are (N, B, h), kernels (h, h). The batch is divided among the threads, each of which runs all N steps.

#include <cstdint>
#include <cstring>
#include <vector>

#include "parallel.h"

namespace ffi = xla::ffi;
using dnnl::memory;
using Tag = dnnl::memory::format_tag;

namespace {

// A product of (rows, inner) and a fixed matrix (inner, columns), which is kept in the layout that is fastest.
class Product {
 public:
  // If `add` is true, the product is added to the result.
  Product(dnnl::stream& stream, int64_t rows, int64_t inner, int64_t columns, const std::vector<float>& matrix,
          bool add)
      : stream_(stream) {
    const auto type = memory::data_type::f32;
    dnnl::primitive_attr attributes;
    if (add) {
      dnnl::post_ops sum;
      sum.append_sum(1.0f);
      attributes.set_post_ops(sum);
    }
    const dnnl::matmul::primitive_desc desc(cpu(), memory::desc({rows, inner}, type, Tag::ab),
                                            memory::desc({inner, columns}, type, Tag::any),
                                            memory::desc({rows, columns}, type, Tag::ab), attributes);
    left_ = desc.src_desc();
    result_ = desc.dst_desc();
    matrix_ =
        reordered(stream, view(memory::desc({inner, columns}, type, Tag::ab), matrix.data()), desc.weights_desc());
    stream.wait();
    primitive_ = dnnl::matmul(desc);
  }

  void operator()(const float* left, float* result) {
    primitive_.execute(
        stream_,
        {{DNNL_ARG_SRC, view(left_, left)}, {DNNL_ARG_WEIGHTS, matrix_}, {DNNL_ARG_DST, view(result_, result)}});
    stream_.wait();
  }

 private:
  dnnl::stream& stream_;
  memory::desc left_, result_;
  memory matrix_;
  dnnl::matmul primitive_;
};

// exp(x) to two units in the last place, without branches, so that a compiler vectorises it.
inline float exponential(float x) {
  x = x < -87.0f ? -87.0f : (x > 88.0f ? 88.0f : x);
  const float shifted = x * 1.44269504f + 12582912.0f;  // whose last bits are the nearest integer to x / ln 2
  const float power = shifted - 12582912.0f;
  const float rest = x - power * 0.693359375f - power * -2.12194440e-4f;
  float sum = 1.0f / 5040;
  for (float coefficient : {1.0f / 720, 1.0f / 120, 1.0f / 24, 1.0f / 6, 0.5f, 1.0f, 1.0f})
    sum = sum * rest + coefficient;
  uint32_t bits;
  std::memcpy(&bits, &shifted, sizeof bits);
  bits = (bits + 127) << 23;
  float scale;
  std::memcpy(&scale, &bits, sizeof scale);
  return sum * scale;
}

inline float sigmoid(float x) { return 1.0f / (1.0f + exponential(-x)); }

// One step of one sequence; `products` are U_r h, U_z h and U_n h of its state `before`.
void next_state(int64_t h, const float* reset, const float* update, const float* fresh, const float* bias,
                const float* products, const float* before, float* after) {
#pragma omp simd
  for (int64_t i = 0; i < h; ++i) {
    const float r = sigmoid(reset[i] + products[i]);
    const float z = sigmoid(update[i] + products[h + i]);
    const float n = 2.0f * sigmoid(2.0f * (fresh[i] + r * (products[2 * h + i] + bias[i]))) - 1.0f;
    after[i] = n + z * (before[i] - n);
  }
}

ffi::Error states(ffi::ThreadPool pool, Array reset, Array update, Array fresh, Array reset_kernel, Array update_kernel,
                  Array fresh_kernel, Array bias, Result states) {
  return guarded([&] {
    const int64_t steps = reset.dimensions()[0], batch = reset.dimensions()[1], h = reset.dimensions()[2];
    const float* each[] = {reset_kernel.typed_data(), update_kernel.typed_data(), fresh_kernel.typed_data()};
    std::vector<float> kernels(3 * h * h);  // side by side, (h, 3 h)
    for (int64_t i = 0; i < h; ++i)
      for (int64_t gate = 0; gate < 3; ++gate) std::copy_n(each[gate] + i * h, h, &kernels[(3 * i + gate) * h]);
    for_each_part(pool, batch, [&](const Part& part) {
      dnnl::stream stream(cpu());
      Product product(stream, part.size, h, 3 * h, kernels, false);
      std::vector<float> products(part.size * 3 * h), start(part.size * h);
      const float* before = start.data();
      for (int64_t step = 0; step < steps; ++step) {
        const int64_t first = (step * batch + part.first) * h;
        product(before, products.data());
        for (int64_t row = 0; row < part.size; ++row) {
          const int64_t place = first + row * h;
          next_state(h, reset.typed_data() + place, update.typed_data() + place, fresh.typed_data() + place,
                     bias.typed_data(), &products[3 * row * h], before + row * h, states->typed_data() + place);
        }
        before = states->typed_data() + first;
      }
    });
  });
}

ffi::Error sums(ffi::ThreadPool pool, Array cotangent, Array slope_of_new, Array slope_of_update, Array slope_of_reset,
                Array slope_of_inner, Array kept, Array reset_kernel, Array update_kernel, Array fresh_kernel,
                Result reset, Result update, Result fresh) {
  return guarded([&] {
    const int64_t steps = kept.dimensions()[0], batch = kept.dimensions()[1], h = kept.dimensions()[2];
    const float* each[] = {reset_kernel.typed_data(), update_kernel.typed_data(), fresh_kernel.typed_data()};
    std::vector<float> kernels(3 * h * h);  // transposed and below each other, (3 h, h)
    for (int64_t gate = 0; gate < 3; ++gate)
      for (int64_t i = 0; i < h; ++i)
        for (int64_t j = 0; j < h; ++j) kernels[(gate * h + j) * h + i] = each[gate][i * h + j];
    for_each_part(pool, batch, [&](const Part& part) {
      dnnl::stream stream(cpu());
      Product add_product(stream, part.size, 3 * h, h, kernels, true);
      std::vector<float> chained(part.size * 3 * h), after(part.size * h);
      for (int64_t step = steps - 1; step >= 0; --step) {
        for (int64_t row = 0; row < part.size; ++row) {
          const int64_t place = (step * batch + part.first + row) * h;
          const auto at = [place](const Array& array) { return array.typed_data() + place; };
          const float *of_state = at(cotangent), *by_new = at(slope_of_new), *by_update = at(slope_of_update);
          const float *by_reset = at(slope_of_reset), *by_inner = at(slope_of_inner), *by_kept = at(kept);
          float *to_reset = reset->typed_data() + place, *to_update = update->typed_data() + place;
          float *to_new = fresh->typed_data() + place, *to_chain = &chained[3 * row * h], *total = &after[row * h];
#pragma omp simd
          for (int64_t i = 0; i < h; ++i) {
            const float all = total[i] + of_state[i];
            const float of_new = all * by_new[i], of_update = all * by_update[i], of_reset = of_new * by_reset[i];
            to_chain[i] = to_reset[i] = of_reset;
            to_chain[h + i] = to_update[i] = of_update;
            to_chain[2 * h + i] = of_new * by_inner[i];
            to_new[i] = of_new;
            total[i] = all * by_kept[i];
          }
        }
        add_product(chained.data(), after.data());
      }
    });
  });
}

}  // namespace

XLA_FFI_DEFINE_HANDLER_SYMBOL(Ha2gGruStates, states,
                              ffi::Ffi::Bind()
                                  .Ctx<ffi::ThreadPool>()
                                  .Arg<Array>()
                                  .Arg<Array>()
                                  .Arg<Array>()
                                  .Arg<Array>()
                                  .Arg<Array>()
                                  .Arg<Array>()
                                  .Arg<Array>()
                                  .Ret<Array>());
XLA_FFI_DEFINE_HANDLER_SYMBOL(Ha2gGruSums, sums,
                              ffi::Ffi::Bind()
                                  .Ctx<ffi::ThreadPool>()
                                  .Arg<Array>()
                                  .Arg<Array>()
                                  .Arg<Array>()
                                  .Arg<Array>()
                                  .Arg<Array>()
                                  .Arg<Array>()
                                  .Arg<Array>()
                                  .Arg<Array>()
                                  .Arg<Array>()
                                  .Ret<Array>()
                                  .Ret<Array>()
                                  .Ret<Array>());
