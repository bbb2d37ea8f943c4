// A convolution and its two gradients. Images are (B, H, W, C), kernels (height, width, inputs, channels).

#include <cstdint>
#include <vector>

#include "parallel.h"

namespace ffi = xla::ffi;
using dnnl::memory;
using Tag = dnnl::memory::format_tag;
using Shape = ffi::Span<const int64_t>;

namespace {

constexpr auto kType = memory::data_type::f32;
constexpr auto kAlgorithm = dnnl::algorithm::convolution_direct;

// A convolution of x (B, H, W, inputs) to y (B, H', W', channels).
struct Convolution {
  Shape x, kernel, y;
  int64_t row_stride, column_stride, padding;

  int64_t x_size() const { return x[1] * x[2] * x[3]; }  // of one image
  int64_t y_size() const { return y[1] * y[2] * y[3]; }
  int64_t kernel_size() const { return kernel[0] * kernel[1] * kernel[2] * kernel[3]; }

  // The shapes in the order that oneDNN names them in, which is not that of the memory.
  memory::desc x_desc(int64_t images) const { return {{images, x[3], x[1], x[2]}, kType, Tag::nhwc}; }
  memory::desc y_desc(int64_t images) const { return {{images, y[3], y[1], y[2]}, kType, Tag::nhwc}; }
  memory::desc kernel_desc(Tag tag) const { return {{kernel[3], kernel[2], kernel[0], kernel[1]}, kType, tag}; }

  memory::dims strides() const { return {row_stride, column_stride}; }
  memory::dims before() const { return {padding, padding}; }
  memory::dims after() const {  // less than `padding` where the stride leaves the last rows or columns out
    return {(y[1] - 1) * row_stride + kernel[0] - x[1] - padding,
            (y[2] - 1) * column_stride + kernel[1] - x[2] - padding};
  }
  dnnl::convolution_forward::primitive_desc forward(int64_t images) const {
    return {cpu(),
            dnnl::prop_kind::forward_training,
            kAlgorithm,
            x_desc(images),
            kernel_desc(Tag::any),
            y_desc(images),
            strides(),
            before(),
            after()};
  }
};

ffi::Error conv(ffi::ThreadPool pool, Array x, Array kernel, Result y, int64_t row_stride, int64_t column_stride,
                int64_t padding) {
  const Convolution shape{x.dimensions(), kernel.dimensions(), y->dimensions(), row_stride, column_stride, padding};
  return guarded([&] {
    for_each_part(pool, shape.x[0], [&](const Part& part) {
      dnnl::stream stream(cpu());
      const auto desc = shape.forward(part.size);
      const memory plain = view(shape.kernel_desc(Tag::hwio), kernel.typed_data());
      dnnl::convolution_forward(desc).execute(
          stream, {{DNNL_ARG_SRC, view(desc.src_desc(), x.typed_data() + part.first * shape.x_size())},
                   {DNNL_ARG_WEIGHTS, reordered(stream, plain, desc.weights_desc())},
                   {DNNL_ARG_DST, view(desc.dst_desc(), y->typed_data() + part.first * shape.y_size())}});
      stream.wait();
    });
  });
}

ffi::Error input_gradient(ffi::ThreadPool pool, Array kernel, Array cotangent, Result gradient, int64_t row_stride,
                          int64_t column_stride, int64_t padding) {
  const Convolution shape{
      gradient->dimensions(), kernel.dimensions(), cotangent.dimensions(), row_stride, column_stride, padding};
  return guarded([&] {
    for_each_part(pool, shape.x[0], [&](const Part& part) {
      dnnl::stream stream(cpu());
      const dnnl::convolution_backward_data::primitive_desc desc(
          cpu(), kAlgorithm, shape.x_desc(part.size), shape.kernel_desc(Tag::any), shape.y_desc(part.size),
          shape.strides(), shape.before(), shape.after(), shape.forward(part.size));
      const memory plain = view(shape.kernel_desc(Tag::hwio), kernel.typed_data());
      dnnl::convolution_backward_data(desc).execute(
          stream,
          {{DNNL_ARG_DIFF_DST, view(desc.diff_dst_desc(), cotangent.typed_data() + part.first * shape.y_size())},
           {DNNL_ARG_WEIGHTS, reordered(stream, plain, desc.weights_desc())},
           {DNNL_ARG_DIFF_SRC, view(desc.diff_src_desc(), gradient->typed_data() + part.first * shape.x_size())}});
      stream.wait();
    });
  });
}

ffi::Error kernel_gradient(ffi::ThreadPool pool, Array x, Array cotangent, Result gradient, int64_t row_stride,
                           int64_t column_stride, int64_t padding) {
  const Convolution shape{x.dimensions(), gradient->dimensions(), cotangent.dimensions(),
                          row_stride,     column_stride,          padding};
  return guarded([&] {
    std::vector<std::vector<float>> sums(count_parts(pool, shape.x[0]));
    for_each_part(pool, shape.x[0], [&](const Part& part) {
      dnnl::stream stream(cpu());
      const dnnl::convolution_backward_weights::primitive_desc desc(
          cpu(), kAlgorithm, shape.x_desc(part.size), shape.kernel_desc(Tag::any), shape.y_desc(part.size),
          shape.strides(), shape.before(), shape.after(), shape.forward(part.size));
      memory sum(desc.diff_weights_desc(), cpu());
      dnnl::convolution_backward_weights(desc).execute(
          stream,
          {{DNNL_ARG_SRC, view(desc.src_desc(), x.typed_data() + part.first * shape.x_size())},
           {DNNL_ARG_DIFF_DST, view(desc.diff_dst_desc(), cotangent.typed_data() + part.first * shape.y_size())},
           {DNNL_ARG_DIFF_WEIGHTS, sum}});
      sums[part.index].resize(shape.kernel_size());
      memory plain = view(shape.kernel_desc(Tag::hwio), sums[part.index].data());
      dnnl::reorder(sum, plain).execute(stream, sum, plain);
      stream.wait();
    });
    float* total = gradient->typed_data();
    std::copy(sums[0].begin(), sums[0].end(), total);
    for (size_t part = 1; part < sums.size(); ++part)
      for (int64_t i = 0; i < shape.kernel_size(); ++i) total[i] += sums[part][i];
  });
}

auto binding() {
  return ffi::Ffi::Bind()
      .Ctx<ffi::ThreadPool>()
      .Arg<Array>()
      .Arg<Array>()
      .Ret<Array>()
      .Attr<int64_t>("row_stride")
      .Attr<int64_t>("column_stride")
      .Attr<int64_t>("padding");
}

}  // namespace

XLA_FFI_DEFINE_HANDLER_SYMBOL(Ha2gConv, conv, binding());
XLA_FFI_DEFINE_HANDLER_SYMBOL(Ha2gConvInputGradient, input_gradient, binding());
XLA_FFI_DEFINE_HANDLER_SYMBOL(Ha2gConvKernelGradient, kernel_gradient, binding());
