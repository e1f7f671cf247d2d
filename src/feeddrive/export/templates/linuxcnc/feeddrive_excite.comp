component feeddrive_excite "Plays a motion with an excitation on one axis, and switches between two controls without a bump. It stands in the place of planner and joint: set gives the set motion before the controls in the thread, act takes their outputs behind them, adds the excitation, and passes the sum to the drive within limits of its own. Lengths in machine units, forces in N. It is no safety function.";

pin in float position-fb "position of the axis";
pin in float old-command "output of the control that the axis has, in the unit of the drive";
pin in float new-force "force of the control on trial, N";
pin in bit new-fault "fault of the control on trial: the old one takes over and brakes";
pin in bit new-running "on while the control on trial runs; one that is enabled and does not is as in fault";
pin in bit drive-fault "fault of the drive: the motion ends with the force off";
pin in bit stop "a person or a program stops the motion: the axis brakes along a ramp";
pin in bit cancel "the same, for the program that plays";
pin in bit reset "a rising edge clears a fault while the axis is off";
pin in unsigned run-number "a change begins a motion";
pin in bit listens "on: the next motion is only logged, and the axis stays off";

pin in unsigned row "number of the row that is played, from 1 on: one that does not follow the last ends the motion";
pin in float row-position "set position, from where the axis stands at the start";
pin in float row-velocity "set velocity, per second";
pin in float row-acceleration "set acceleration, per second squared";
pin in float row-excitation "force that is added, N";
pin in bit row-new "on: the control on trial acts";
pin in bit row-log "on: the row is recorded";
pin in bit row-last "on: the motion ends with this row";

pin out bit streaming "to the enable of the streamer";
pin out float set-position "set position";
pin out float set-velocity "set velocity, per second";
pin out float set-acceleration "set acceleration, per second squared";
pin out bit old-enable "enable of the control that the axis has";
pin out bit new-enable "enable of the control on trial";
pin out bit drive-enable "enable of the drive";
pin out bit brake-open "on while the brake is to be open: it closes before the drive is switched off";
pin out bit off "on while the axis is off";
pin out bit logging "on while rows are recorded";
pin out float command "command to the drive, in its unit";
pin out float force "force that is commanded in all, N";
pin out float control-force "force of the control that acts, N";
pin out float excitation "force of the excitation, N";
pin out float handover "difference to the control that was left, which fades away, N";
pin out unsigned active "0 the old control acts, 1 the one on trial";
pin out bit fault "on from a fault until reset";
pin out signed fault-code "why: 0 none, 1 stopped by hand, 2 no row came, 3 travel, 4 velocity, 5 force at its limit, 6 following error, 7 position is not a number, 8 a control's output is not a number, 9 fault of the control on trial, 10 fault of the drive, 11 runaway, 12 position out of its ends, 13 a row asks for more than the velocity";
pin out float fault-value "value that exceeded its limit, in the unit of the limit";
pin out unsigned ended "number of motions that have ended";
pin out unsigned played "number of the last row that was played";

param r unsigned version = 1 "version of this file: it rises with every change of what the component does";
param rw float force-per-unit = 1 "force at the table per unit of the drive's command, N";
param rw float travel-limit = 0 "farthest from the start, to both sides";
param rw float velocity-limit = 0 "largest speed, per second";
param rw float force-limit = 0 "largest force, N; larger commands are cut";
param rw float force-time = 0.1 "time at the force limit that ends the motion, s";
param rw float error-limit = 0 "largest difference of set position and position";
param rw float deceleration = 0 "with which a stopped axis brakes, per second squared";
param rw float position-least = -1e30 "lowest position";
param rw float position-most = 1e30 "highest position";
param rw float rest-time = 0.2 "time for which the end of a braking ramp is held, s";
param rw float brake-time = 0 "time in which the brake closes, for which the axis is held, s";
param rw float coast-time = 1 "longest time for which an axis without force is watched, s";
param rw unsigned handover-rows = 0 "periods in which the difference of two controls fades away";

function set fp;
function act fp;
option singleton yes;
include <math.h>;
license "MIT";
author "feeddrive";

;;

enum { STATE_OFF, STATE_LISTENS, STATE_PLAYS, STATE_BRAKES, STATE_CLOSES, STATE_COASTS };
enum { BY_HAND = 1, DRY, TRAVEL, VELOCITY, FORCE, ERROR, READING, COMMAND, NEW_FAULT, DRIVE_FAULT, RUNAWAY, ENDS, JUMP };
enum { WINDOW = 8 }; /* periods over which the velocity is a mean */

static int state;
static int reason;                  /* fault code, kept until reset */
static double amount;               /* value that exceeded its limit */
static unsigned ends;               /* motions that have ended */
static bool was_reset, wanted;      /* wanted: the control on trial shall act */
static unsigned last_run, next_row;
static double start, target, speed; /* set position, and its speed per second */
static double left;                 /* s until a braking or a coasting axis is done */
static double past[WINDOW];         /* readings of the last periods, the oldest at `place` */
static unsigned place;
static double difference;           /* N, of the two controls at the last switch */
static unsigned faded;              /* periods since then */
static double last_own;             /* N, of the control that acts, in the last period */
static double saturated;            /* s at the force limit */
static double error_before;
static int fleeing;                 /* periods in a row in which the axis flees from its target */

static void trip(int code, double value, int next, double time)
{
    if (reason == 0) {
        reason = code;
        amount = value;
    }
    state = next;
    left = time;
}

/* a motion ends: the axis is held until the brake has closed */
static void rest(double closing)
{
    const bool held = (state == STATE_PLAYS || state == STATE_BRAKES) && closing > 0.0;

    state = held ? STATE_CLOSES : STATE_OFF;
    left = closing;
    if (!held)
        ends++;
}

/* the difference of the controls that is left: it ends without a corner, and exactly at 0 */
static double fading(unsigned rows)
{
    return faded < rows ? 0.5 * difference * (1.0 + cos(M_PI * (double)faded / (double)rows)) : 0.0;
}

FUNCTION(set)
{
    const double T = 1e-9 * (double)period;
    const double here = position_fb;
    const bool halted = stop || cancel;

    logging = false;
    if (reset && !was_reset && state == STATE_OFF) {
        reason = 0;
        amount = 0.0;
        played = 0;
    }
    was_reset = reset;

    if (state == STATE_OFF && run_number != last_run) {
        last_run = run_number;
        if (reason == 0 && !isfinite(here))
            trip(READING, 0.0, STATE_OFF, 0.0);
        if (reason == 0 && halted)
            trip(BY_HAND, 0.0, STATE_OFF, 0.0);
        if (reason != 0) {
            rest(0.0);
        } else {
            state = listens ? STATE_LISTENS : STATE_PLAYS;
            next_row = 1;
            start = target = here;
            speed = difference = last_own = saturated = error_before = 0.0;
            faded = handover_rows;
            fleeing = 0;
            for (int i = 0; i < WINDOW; i++)
                past[i] = here;
        }
    } else if (state == STATE_PLAYS || state == STATE_LISTENS) {
        const int next = state == STATE_PLAYS ? STATE_BRAKES : STATE_COASTS;
        const double asked = (start + row_position - target) / T;
        if (halted) {
            trip(BY_HAND, 0.0, next, rest_time);
        } else if (row != next_row) {
            trip(DRY, (double)played, next, rest_time);
        } else if (row_last) {
            rest(brake_time);
        } else if (state == STATE_PLAYS && !(fabs(asked) <= (1.0 + 1e-9) * velocity_limit)) {
            trip(JUMP, asked, STATE_BRAKES, rest_time);
        } else {
            next_row = row + 1;
            played = row;
            logging = row_log;
            if (state == STATE_PLAYS) {
                speed = asked;
                target = start + row_position;
                set_velocity = row_velocity;
                set_acceleration = row_acceleration;
                wanted = row_new;
            }
        }
    }
    if (state == STATE_BRAKES) {
        const double step = deceleration * T;
        const double after = fabs(speed) > step ? speed - copysign(step, speed) : 0.0;
        if (speed == 0.0)
            left -= T;
        target += 0.5 * (speed + after) * T;
        set_acceleration = (after - speed) / T;
        set_velocity = speed = after;
        if (left < 0.0)
            rest(brake_time);
    } else if (state == STATE_CLOSES) {
        left -= T;
        set_velocity = set_acceleration = 0.0;
        if (left < 0.0)
            rest(0.0);
    } else if (state == STATE_COASTS) {
        left -= T;
        /* an axis that has come to rest need not be watched any longer */
        if (left < 0.0 || here == past[place])
            rest(0.0);
    }

    const bool on = state == STATE_PLAYS || state == STATE_BRAKES || state == STATE_CLOSES;
    if (!on) {
        target = here;
        set_velocity = set_acceleration = 0.0;
        wanted = false;
        active = 0;
    }
    set_position = target;
    /* both are enabled in the period of the switch; before and after it the other one is off and cannot wind up */
    old_enable = on && (active == 0 || !wanted);
    new_enable = on && (active == 1 || wanted);
    drive_enable = on;
    brake_open = on && state != STATE_CLOSES;
    off = state == STATE_OFF || state == STATE_LISTENS;
    streaming = state == STATE_PLAYS || state == STATE_LISTENS;
    ended = ends;
    fault = reason != 0;
    fault_code = reason;
    fault_value = amount;
}

FUNCTION(act)
{
    const double T = 1e-9 * (double)period;
    const double here = position_fb, error = set_position - here;
    const double velocity = (here - past[place]) / (WINDOW * T);
    const double old_force = old_command * force_per_unit;
    const bool failed = new_fault || (new_enable && !new_running);
    double own = 0.0, blend = 0.0, added = 0.0, asked = 0.0;

    if (state == STATE_PLAYS || state == STATE_BRAKES || state == STATE_CLOSES) {
        /* a control that trips gives no force of a control: the last one is held until the old control runs */
        const double leaving = active == 0 ? old_force : failed ? last_own : (double)new_force;
        if (wanted && failed && state != STATE_CLOSES)
            trip(NEW_FAULT, 0.0, STATE_BRAKES, rest_time);
        if (faded < handover_rows)
            faded++;
        own = leaving;
        blend = fading(handover_rows);
        bool change = active != (unsigned)wanted;
        if (failed) {
            wanted = false;
            change = active == 1 && old_enable; /* the old control is enabled in the period after the fault only */
        }
        if (change) {
            own = wanted ? (double)new_force : old_force;
            difference = leaving + blend - own;
            faded = 0;
            blend = fading(handover_rows);
            active = wanted;
        }
        last_own = own;
        added = state == STATE_PLAYS && played > 0 ? (double)row_excitation : 0.0;
        asked = own + blend + added;

        const double ahead = 3.0 * fabs(velocity) * T + 0.5 * velocity * velocity / deceleration;
        const double way = copysign(1.0, velocity), from_start = here - start;
        /* written so that a number that is none is beyond every limit */
        if (!isfinite(here))
            trip(READING, 0.0, STATE_COASTS, coast_time);
        else if (!isfinite(asked))
            trip(COMMAND, 0.0, STATE_COASTS, coast_time);
        else if (drive_fault)
            trip(DRIVE_FAULT, 0.0, STATE_COASTS, coast_time);
        else if (!(fabs(error) <= error_limit))
            trip(ERROR, error, STATE_COASTS, coast_time);
        else if (!(fabs(velocity) <= velocity_limit))
            trip(VELOCITY, velocity, STATE_COASTS, coast_time);
        else if (!(fabs(from_start) <= travel_limit))
            trip(TRAVEL, from_start, STATE_COASTS, coast_time);
        else if (state == STATE_PLAYS && !(way * from_start + ahead <= travel_limit))
            trip(TRAVEL, from_start + way * ahead, STATE_BRAKES, rest_time);
        else if (state == STATE_PLAYS && !(velocity < 0.0 ? here - ahead >= position_least : here + ahead <= position_most))
            trip(ENDS, here + way * ahead, STATE_BRAKES, rest_time);

        /* away from its target and driven by its force, with half of the error that is allowed */
        const bool flees = fabs(error) > 0.5 * error_limit && error * velocity < 0.0 && asked * velocity > 0.0;
        fleeing = flees && fabs(error) > fabs(error_before) ? fleeing + 1 : 0;
        error_before = error;
        if (fleeing > WINDOW)
            trip(RUNAWAY, error, STATE_COASTS, coast_time);

        saturated = fabs(asked) > force_limit ? saturated + T : 0.0;
        if (fabs(asked) > force_limit)
            asked = copysign(force_limit, asked);
        if (saturated > force_time)
            trip(FORCE, asked, STATE_COASTS, coast_time);
    }
    if (state == STATE_COASTS) {
        drive_enable = brake_open = old_enable = new_enable = false;
        own = blend = added = asked = 0.0;
    }
    past[place] = here;
    place = (place + 1) % WINDOW;

    control_force = own;
    handover = blend;
    excitation = added;
    force = asked;
    command = asked / force_per_unit;
    fault = reason != 0;
    fault_code = reason;
    fault_value = amount;
}
