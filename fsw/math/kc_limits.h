/* Every fixed size of the flight software, in one place.
 *
 * Changing a number here changes static memory; `make size` prints what it costs
 * and a test fails when the core passes 1 MiB. */
#ifndef KC_LIMITS_H
#define KC_LIMITS_H

#ifndef KC_GROUND
#define KC_JOINT_MAX 8u  /* joints of an arm */
#define KC_COEF_MAX 64u  /* coefficients estimated together */
#define KC_TERM_MAX 160u /* correction terms (several may share a coefficient) */
#define KC_PNP_MAX 0u    /* columns of a PnP pose: flight computes none */
#define KC_MOVE_MAX 0u   /* joints whose last move a basis may follow: flight waits for rest */
#else /* build of math and model for the ground (ground/native): larger arms and models */
#define KC_JOINT_MAX 16u
#define KC_COEF_MAX 256u
#define KC_TERM_MAX 1024u
#define KC_PNP_MAX 24u /* columns of a PnP pose that one model may use */
#define KC_MOVE_MAX 16u
#endif
#define KC_MEAS_MAX 64u     /* measurements held */
#define KC_CAND_MAX 1024u   /* candidate poses */
#define KC_HUB_MAX 16u      /* hub poses */
#define KC_BODY_MAX 24u     /* capsules that stand for the arm */
#define KC_VOLUME_MAX 16u   /* volumes that the arm must not enter */
#define KC_INITIAL_MAX 32u  /* initial poses that start a calibration */
#define KC_STOP_MAX 4u      /* stops on the way to a candidate */
#define KC_TAG_MAX 4u       /* tags on the tool */
#define KC_SPECTRUM_MAX 96u /* spectral coefficients of the rotation kernel */
#define KC_HYPER_MAX 32u    /* hyperparameter sets to choose from on board */
#define KC_NAME_LEN 24u     /* bytes of a name, NUL padded and NUL terminated */

/* Frames that a correction term may act in: 0 = base .. n = last link, then: */
#define KC_FRAME_TOOL (KC_JOINT_MAX + 1u)   /* after the tool frame f_T */
#define KC_FRAME_CAMERA (KC_JOINT_MAX + 2u) /* after the camera pose in the base frame */
#define KC_FRAME_MEAS (KC_JOINT_MAX + 3u)   /* after the measured camera-to-tool pose */
#define KC_FRAME_COUNT (KC_JOINT_MAX + 4u)

#define KC_EVENTS_MAX 64u     /* events one step can raise before it drops */
#define KC_CMD_QUEUE_MAX 8u   /* commands one step takes in */
#define KC_CHUNK_QUEUE_MAX 8u /* table chunks one step takes in */
#define KC_DET_QUEUE_MAX 4u   /* detections one step takes in */
#define KC_CHUNK_BYTES 1024u  /* payload of one table chunk */
#define KC_IMAGE_MAX (144u * 1024u) /* largest table image */
#define KC_KEY_MAX \
    4u /* keys that are valid at the same time: of two holders, the old and the new one of a rotation */
#define KC_SCRUB_BYTES 4096u /* memory that one step compares with its CRC */

/* Instructions that one step spends on computations that go on in the next (kc_work.h). */
#define KC_STEP_WORK 9000000u

#endif
