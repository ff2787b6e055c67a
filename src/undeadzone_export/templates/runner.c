#include "@name@.h"
#include <string.h>
void run(long steps, const @name@_in *in, @name@_out *out, @name@_state *state);
void start(@name@_state *state);
void start(@name@_state *state)
{
    @name@_init(state);
}
void run(long steps, const @name@_in *in, @name@_out *out, @name@_state *state)
{
@?tunable@    @name@_params params;
@?tunable@    @name@_params_default(&params);
    for (long k = 0; k < steps; k++) {
        @name@_step(state, @params@&in[k], &out[k]);
    }
}
