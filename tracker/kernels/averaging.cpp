// From poses to ticks: what `ticks`, `free_motion` and `noise` do in every tick.
#include "averaging.hpp"

#include "bindings.hpp"
#include "hearing.hpp"

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

py::tuple moved(const py::tuple& state, const Floats& rotation, const Floats& position,
                const Floats& variance, const Floats& onward, const Floats& jerk, double fade,
                double fade_shape) {
    require_shape(rotation, {3, 3}, "a rotation is a matrix");
    require_shape(position, {3}, "a position has three numbers");
    require_shape(variance, {2}, "two variances");
    require_shape(onward, {6, 6}, "what a tick does to two states");
    require_shape(jerk, {6, 6}, "what jerk does to two states");
    Motion motion = motion_of(state);
    Onward tick{{}, {}, fade, fade_shape};
    for (int i = 0; i < 3; ++i) {
        std::copy_n(onward.data() + 6 * i, 3, tick.onward[i]);
        std::copy_n(jerk.data() + 6 * i, 3, tick.jerk[i]);
    }
    double excess[2];
    advance(motion, rotation.data(), at(position.data(), 0), variance.data(), tick, excess);
    return py::make_tuple(fields_of(motion), excess[0], excess[1]);
}

Frames frames_of(const Floats& position, const Floats& quat) {
    require(position.ndim() == 2 && position.shape(0) > 0, "there are no frames");
    require_shape(position, {position.shape(0), 3}, "a position has three numbers");
    require_shape(quat, {position.shape(0), 4}, "a quaternion has four numbers");
    return {position.data(), quat.data(), static_cast<int>(position.shape(0))};
}

py::tuple averaged(const Floats& position, const Floats& quat, const Floats& ahead,
                   const std::optional<py::tuple>& motion, const Floats& origin, const Floats& sigma_sq,
                   double outlier_sigmas) {
    const Frames frames = frames_of(position, quat);
    require_shape(ahead, {frames.count}, "a frame has one time");
    require_shape(origin, {3}, "an origin has three numbers");
    require_shape(sigma_sq, {2}, "two variances");
    const Motion moving = motion ? motion_of(*motion) : Motion{};
    const Vector from = at(origin.data(), 0);
    Bools good(frames.count);
    Floats zeta(25);
    plausible(frames, ahead.data(), motion ? &moving : nullptr, from, sigma_sq.data(), outlier_sigmas,
              good.mutable_data());
    mean_lift(frames, good.data(), from, zeta.mutable_data());
    return py::make_tuple(good, zeta);
}

Floats differences_of(const Ints& stamp_ns, const Floats& position, const Floats& quat) {
    const Frames frames = frames_of(position, quat);
    require_shape(stamp_ns, {frames.count}, "a frame has one stamp");
    const std::vector<double> all = third_differences(frames, stamp_ns.data());
    return array_of({static_cast<py::ssize_t>(all.size()) / differences, differences}, all.data());
}

py::tuple told(const Floats& position, const Floats& rotation, const Floats& shape, const Floats& heard,
               const Floats& deviation, const Floats& prior) {
    require_shape(position, {3, 3}, "a covariance is a matrix");
    require_shape(rotation, {3, 3}, "a covariance is a matrix");
    require_shape(shape, {6, 6}, "a shape is that of two vectors");
    require(heard.ndim() == 2 && heard.shape(0) == differences && heard.shape(1) > 0, "no differences");
    require_shape(deviation, {2}, "two deviations");
    require_shape(prior, {2}, "two deviations");
    Noise noise;
    std::copy_n(position.data(), 9, noise.position[0]);
    std::copy_n(rotation.data(), 9, noise.rotation[0]);
    std::copy_n(shape.data(), 36, noise.shape[0]);
    tell(heard.data(), static_cast<int>(heard.shape(1)), deviation.data(), prior.data(), noise);
    double at_centre[3];
    put(at_centre, 0, noise.centre);
    return py::make_tuple(array_of({3, 3}, noise.position[0]), array_of({3, 3}, noise.rotation[0]),
                          array_of({3}, at_centre), array_of({6, 6}, noise.shape[0]));
}

}  // namespace

void add_averaging(py::module_& module) {
    module.def("moved", &moved);
    module.def("averaged", &averaged);
    module.def("third_differences", &differences_of);
    module.def("told", &told);
}

}  // namespace kernels
