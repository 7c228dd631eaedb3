// From frames to ticks, as in `averaging`.
#include "averaging.hpp"

#include "bindings.hpp"
#include "closing.hpp"

namespace kernels {
namespace {

// The arrays of a state, in its order.
class Fields {
public:
    explicit Fields(const py::tuple& fields) : fields_(fields) {}

    // Copy the next one, of a `shape`, to `out`.
    void take(const std::vector<py::ssize_t>& shape, double* out) {
        const Floats field = py::cast<Floats>(fields_[next_++]);
        require_shape(field, shape, "a state does not have its fields");
        std::copy_n(field.data(), field.size(), out);
    }

    Floats rows() { return py::cast<Floats>(fields_[next_++]); }

    template <class Number>
    Number number() {
        return py::cast<Number>(fields_[next_++]);
    }

private:
    const py::tuple& fields_;
    std::size_t next_ = 0;
};

Floats array_of(const std::vector<py::ssize_t>& shape, const double* values) {
    Floats out(shape);
    std::copy_n(values, out.size(), out.mutable_data());
    return out;
}

// `free_motion.FreeMotion`.
Motion motion_of(const py::tuple& state) {
    Fields fields(state);
    Motion motion;
    double x[2][3][3], covariance[6][6], last[2][3], orientation[4], log_square[2][2], shape[2][3][3],
        direction[2][3], echo[2];
    fields.take({2, 3, 3}, x[0][0]);
    fields.take({6, 6}, covariance[0]);
    fields.take({2, 3}, last[0]);
    fields.take({4}, orientation);
    fields.take({2, 2}, log_square[0]);
    motion.weight = fields.number<double>();
    const Floats latest = fields.rows();
    require(latest.ndim() == 3 && latest.shape(0) <= settings.motion.now_ticks, "too many latest errors");
    require_shape(latest, {latest.shape(0), 2, 2}, "two errors of two vectors");
    fields.take({2, 3, 3}, shape[0][0]);
    fields.take({2, 3}, direction[0]);
    fields.take({2}, echo);
    motion.ticks = fields.number<int>();
    motion.orientation = quaternion_at(orientation);
    motion.latest = static_cast<int>(latest.shape(0));
    for (int i = 0; i < 2; ++i) {
        Path& path = motion.path[i];
        std::copy_n(x[i][0], 9, path.state[0]);
        std::copy_n(shape[i][0], 9, path.shape[0]);
        std::copy_n(log_square[i], 2, path.log_square);
        path.last = at(last[i], 0);
        path.direction = at(direction[i], 0);
        path.echo = echo[i];
        for (int j = 0; j < 3; ++j) std::copy_n(covariance[3 * i + j] + 3 * i, 3, path.covariance[j]);
        for (int n = 0; n < motion.latest; ++n) std::copy_n(latest.data() + 4 * n + 2 * i, 2, path.latest[n]);
    }
    return motion;
}

py::tuple fields_of(const Motion& motion) {
    double x[2][3][3], covariance[6][6] = {}, last[2][3], orientation[4], log_square[2][2],
                       latest[Path::most][2][2], shape[2][3][3], direction[2][3], echo[2];
    for (int i = 0; i < 2; ++i) {
        const Path& path = motion.path[i];
        std::copy_n(path.state[0], 9, x[i][0]);
        std::copy_n(path.shape[0], 9, shape[i][0]);
        std::copy_n(path.log_square, 2, log_square[i]);
        put(last[i], 0, path.last);
        put(direction[i], 0, path.direction);
        echo[i] = path.echo;
        for (int j = 0; j < 3; ++j) std::copy_n(path.covariance[j], 3, covariance[3 * i + j] + 3 * i);
        for (int n = 0; n < motion.latest; ++n) std::copy_n(path.latest[n], 2, latest[n][i]);
    }
    put(orientation, motion.orientation);
    return py::make_tuple(array_of({2, 3, 3}, x[0][0]), array_of({6, 6}, covariance[0]),
                          array_of({2, 3}, last[0]), array_of({4}, orientation),
                          array_of({2, 2}, log_square[0]), motion.weight,
                          array_of({motion.latest, 2, 2}, latest[0][0]), array_of({2, 3, 3}, shape[0][0]),
                          array_of({2, 3}, direction[0]), array_of({2}, echo), motion.ticks);
}

Averaging averaging_of(std::int64_t tick_ns, const std::array<double, 2>& prior,
                       const std::array<double, 2>& floor, double outlier_sigmas, bool estimated,
                       const Floats& onward, const Floats& jerk, double fade, double fade_shape) {
    require(tick_ns > 0, "a tick takes time");
    require_shape(onward, {6, 6}, "what a tick does to two states");
    require_shape(jerk, {6, 6}, "what jerk does to two states");
    Averaging how{tick_ns, prior, floor, outlier_sigmas, estimated, {{}, {}, fade, fade_shape}};
    for (int i = 0; i < 3; ++i) {
        std::copy_n(onward.data() + 6 * i, 3, how.onward.onward[i]);
        std::copy_n(jerk.data() + 6 * i, 3, how.onward.jerk[i]);
    }
    return how;
}

using Columns = std::tuple<Ints, Floats, Floats>;
using NoiseFields = std::tuple<Floats, Floats, Floats, Floats>;

Frames frames_of(const Columns& columns) {
    const auto& [stamp_ns, position, quat] = columns;
    const py::ssize_t count = stamp_ns.size();
    require_shape(stamp_ns, {count}, "a frame has one stamp");
    require_shape(position, {count, 3}, "a position has three numbers");
    require_shape(quat, {count, 4}, "a quaternion has four numbers");
    return {position.data(), quat.data(), static_cast<int>(count)};
}

Columns columns_of(const Kept& kept) {
    const py::ssize_t count = kept.count();
    Ints stamp_ns(count);
    std::copy_n(kept.stamp_ns.data(), count, stamp_ns.mutable_data());
    return {stamp_ns, array_of({count, 3}, kept.position.data()), array_of({count, 4}, kept.quat.data())};
}

Noise noise_of(const NoiseFields& fields) {
    const auto& [position, rotation, centre, shape] = fields;
    require_shape(position, {3, 3}, "a covariance is a matrix");
    require_shape(rotation, {3, 3}, "a covariance is a matrix");
    require_shape(centre, {3}, "a centre has three numbers");
    require_shape(shape, {6, 6}, "a shape is that of two vectors");
    Noise noise;
    std::copy_n(position.data(), 9, noise.position[0]);
    std::copy_n(rotation.data(), 9, noise.rotation[0]);
    noise.centre = at(centre.data(), 0);
    std::copy_n(shape.data(), 36, noise.shape[0]);
    return noise;
}

NoiseFields fields_of(const Noise& noise) {
    double centre[3];
    put(centre, 0, noise.centre);
    return {array_of({3, 3}, noise.position[0]), array_of({3, 3}, noise.rotation[0]), array_of({3}, centre),
            array_of({6, 6}, noise.shape[0])};
}

Learnt learnt_of(const NoiseFields& noise, const Floats& heard, const Columns& waiting,
                 const std::optional<py::tuple>& motion) {
    require(heard.ndim() == 2 && heard.shape(0) == differences, "differences have their rows");
    Learnt learnt{noise_of(noise), heard.data(), static_cast<int>(heard.shape(1)), {}, {}, {}};
    const Frames frames = frames_of(waiting);
    for (int n = 0; n < frames.count; ++n) learnt.waiting.add(frames, std::get<0>(waiting).data(), n);
    if (motion) learnt.motion = motion_of(*motion);
    return learnt;
}

py::tuple averaged(const Averaging& how, const Ints& ends, std::int64_t first_ns, const Floats& origin,
                   bool is_rest, const Columns& columns, const NoiseFields& noise, const Floats& heard,
                   const Columns& waiting, const std::optional<py::tuple>& motion) {
    require_shape(origin, {3}, "an origin has three numbers");
    require_shape(ends, {ends.size()}, "a tick has one end");
    const Frames all = frames_of(columns);
    const std::int64_t* stamps = std::get<0>(columns).data();
    Learnt learnt = learnt_of(noise, heard, waiting, motion);
    py::list told, zeta, count, outliers, excess;
    int first = 0;
    for (py::ssize_t i = 0; i < ends.size(); ++i) {
        const std::int64_t end = ends.data()[i];
        require(end > first && end <= all.count, "a tick has frames");
        const Frames frames{all.position + 3 * first, all.quat + 4 * first, static_cast<int>(end) - first};
        const Mean mean = close(frames, stamps + first, first_ns + i * how.tick_ns, at(origin.data(), 0),
                                is_rest && i == 0, how, learnt);
        if (mean.told) told.append(py::make_tuple(i, fields_of(learnt.noise)));
        zeta.append(array_of({25}, mean.zeta));
        count.append(mean.count);
        outliers.append(mean.outliers);
        excess.append(py::make_tuple(mean.excess[0], mean.excess[1]));
        first = static_cast<int>(end);
    }
    const py::object all_heard =
        told.empty() ? py::object(py::none()) : array_of({differences, learnt.known}, learnt.differences);
    return py::make_tuple(told, all_heard, columns_of(learnt.waiting),
                          learnt.motion ? py::object(fields_of(*learnt.motion)) : py::none(),
                          py::make_tuple(zeta, count, outliers, excess));
}

}  // namespace

void add_averaging(py::module_& module) {
    py::class_<Averaging>(module, "Averaging").def(py::init(&averaging_of));
    module.def("averaged", &averaged);
}

}  // namespace kernels
