# KinCal: build, test and demo. `make help` lists the targets.
#
# Sources are found by pattern: a new .c file, test or message needs no edit here. Products go to
# build/, the Python environment to .venv; both can be deleted at any time.

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.SUFFIXES:
MAKEFLAGS += --no-builtin-rules

Q        := $(if $(V),,@)
BUILD    ?= build
PYTHON   ?= python3
CLANG    ?= clang-19
CLANGXX  ?= clang++-19
export PYTHON

PY       := .venv/bin/python
LAYERS   := math eigen model estimate design motion tables decide exec
CORE_SRC := $(sort $(wildcard $(LAYERS:%=fsw/%/*.c) $(LAYERS:%=fsw/%/*.cpp)))
LCM_SRC  := $(sort $(wildcard fsw/lcm/*.c))
MAIN_SRC := $(filter %main.c,$(LCM_SRC))
TAG_SRC  := $(sort $(wildcard sim/tagdet/*.c sim/tagdet/*.cpp))
MSGS     := $(sort $(wildcard fsw/msg/*.lcm))
UNITS    := $(sort $(wildcard tests/unit/test_*.c))
UNIT_AUX := $(filter-out $(UNITS),$(sort $(wildcard tests/unit/*.c)))
HEADERS  := $(sort $(wildcard $(LAYERS:%=fsw/%/kc_*.h)))
# The ground's build of the same source: its limits (KC_GROUND), what models need, and loops over poses.
GND_DIRS := fsw/math fsw/model ground/native
GND_SRC  := $(sort $(wildcard $(GND_DIRS:%=%/*.c)))
GND_HDRS := $(sort $(wildcard $(GND_DIRS:%=%/k[cg]_*.h)))

WARN     := -Wall -Wextra -Werror -Wconversion -Wshadow -Wdouble-promotion
# -ffp-contract=off: no fused multiply-add, so that every CPU gets the same bits.
COMMON   := $(WARN) -ffp-contract=off -fPIC -g $(LAYERS:%=-Ifsw/%) -Iground/native -isystem /usr/include/eigen3
CFLAGS   := -std=c11 -Wstrict-prototypes -Wmissing-prototypes -Wvla $(COMMON)
CXXFLAGS := -std=c++17 -fno-exceptions -fno-rtti -DEIGEN_DONT_VECTORIZE $(COMMON)
# Test functions need no prototype: the generated main() declares them. For clang, NAN is a float.
UNITFLAG := -Wno-missing-prototypes -Wno-double-promotion -isystem $(BUILD)/unity/src -Itests/unit -DUNITY_INCLUDE_DOUBLE

.PHONY: help
help: ## list the targets (V=1 shows whole commands)
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  %-15s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

# ---- set-up: what is missing is installed, once; afterwards nothing here needs a network -------------

STAMP := $(BUILD)/stamp

.PHONY: setup setup-demo
setup: setup-demo $(STAMP)/apt-test .venv/.stamp-dev $(BUILD)/unity/src/unity.c ## all that tests need
setup-demo: $(STAMP)/apt-build .venv/.stamp ## all that the demo needs

$(STAMP)/apt-%: .ci/packages.%
	@mkdir -p $(@D)
	@.ci/apt $<
	@touch $@

.venv/.stamp: ground/requirements.lock .ci/venv | $(STAMP)/apt-build
	.ci/venv ground/requirements.lock
	@touch $@

.venv/.stamp-dev: ground/requirements-dev.lock .venv/.stamp
	.ci/venv ground/requirements-dev.lock
	@touch $@

$(BUILD)/unity/src/unity.c:
	.ci/unity $(BUILD)/unity

.PHONY: lock
lock: ## resolve the Python requirements anew (needs the network)
	.ci/lock

# ---- messages -----------------------------------------------------------------------------------------

GEN_C := $(MSGS:fsw/msg/%.lcm=$(BUILD)/gen/kcm_%.c)

.PHONY: messages
messages: $(STAMP)/messages ## LCM types for C and Python

$(GEN_C): $(STAMP)/messages ;
$(STAMP)/messages: $(MSGS) | $(STAMP)/apt-build
	@rm -rf $(BUILD)/gen $(BUILD)/py/kcm && mkdir -p $(@D) $(BUILD)/gen $(BUILD)/py
	$(Q)lcm-gen -c --c-cpath $(BUILD)/gen --c-hpath $(BUILD)/gen $(MSGS)
	$(Q)lcm-gen -p --ppath $(BUILD)/py $(MSGS)
	@touch $@

# ---- objects, once per variant ------------------------------------------------------------------------
# rel   what flies, with its call graph for `make size`
# san   AddressSanitizer and UndefinedBehaviorSanitizer
# cov   line and branch counters
# clang only compiled: the second opinion on warnings
# gnd   the ground's limits; faster, and still the same bits: a fit evaluates millions of poses

SAN := -fsanitize=address,undefined -fno-sanitize-recover=all -fno-omit-frame-pointer

objects = $(patsubst %,$(BUILD)/$1/%.o,$2)

# variant NAME, C compiler, C++ compiler, flags
define variant
$(BUILD)/$1/flags: FORCE
	@mkdir -p $$(@D)
	@echo '$2 $3 $4 $$(CFLAGS) $$(CXXFLAGS) $$(UNITFLAG)' | cmp -s - $$@ || \
	    echo '$2 $3 $4 $$(CFLAGS) $$(CXXFLAGS) $$(UNITFLAG)' > $$@

$(BUILD)/$1/fsw/lcm/%.c.o: fsw/lcm/%.c $(BUILD)/$1/flags $(STAMP)/messages | $(STAMP)/apt-build
	@mkdir -p $$(@D)
	$$(Q)echo "  CC  $$@"; $2 $$(CFLAGS) $4 -isystem $(BUILD)/gen -MMD -MP -c $$< -o $$@

$(BUILD)/$1/fsw/%.c.o: fsw/%.c $(BUILD)/$1/flags | $(STAMP)/apt-build
	@mkdir -p $$(@D)
	$$(Q)echo "  CC  $$@"; $2 $$(CFLAGS) $4 -MMD -MP -c $$< -o $$@

$(BUILD)/$1/ground/%.c.o: ground/%.c $(BUILD)/$1/flags | $(STAMP)/apt-build
	@mkdir -p $$(@D)
	$$(Q)echo "  CC  $$@"; $2 $$(CFLAGS) $4 -MMD -MP -c $$< -o $$@

$(BUILD)/$1/fsw/%.cpp.o: fsw/%.cpp $(BUILD)/$1/flags | $(STAMP)/apt-build
	@mkdir -p $$(@D)
	$$(Q)echo "  CXX $$@"; $3 $$(CXXFLAGS) $4 -MMD -MP -c $$< -o $$@

$(BUILD)/$1/gen/%.c.o: $(BUILD)/gen/%.c $(BUILD)/$1/flags
	@mkdir -p $$(@D)
	$$(Q)echo "  CC  $$@"; $2 -std=c11 -O1 -g -fPIC -w -c $$< -o $$@

$(BUILD)/$1/unity/unity.c.o: $(BUILD)/unity/src/unity.c $(BUILD)/$1/flags
	@mkdir -p $$(@D)
	$$(Q)echo "  CC  $$@"; $2 -std=c11 -O1 -g -w $$(UNITFLAG) -c $$< -o $$@

$(BUILD)/$1/tests/unit/%.c.o: tests/unit/%.c $(BUILD)/$1/flags $(STAMP)/messages | $(BUILD)/unity/src/unity.c
	@mkdir -p $$(@D)
	$$(Q)echo "  CC  $$@"; $2 $$(CFLAGS) $4 $$(UNITFLAG) -Ifsw/lcm -isystem $(BUILD)/gen -MMD -MP -c $$< -o $$@

$(BUILD)/$1/tests/unit/%.runner.o: $(BUILD)/runners/%.c $(BUILD)/$1/flags | $(BUILD)/unity/src/unity.c
	@mkdir -p $$(@D)
	$$(Q)echo "  CC  $$@"; $2 -std=c11 -O1 -g -w $4 $$(UNITFLAG) -c $$< -o $$@

$(BUILD)/$1/libkincal.a: $(call objects,$1,$(CORE_SRC))
	@rm -f $$@ && ar rcs $$@.new $$^ && mv $$@.new $$@

$(BUILD)/$1/libkcedge.a: $(call objects,$1,$(filter-out $(MAIN_SRC),$(LCM_SRC))) \
                         $(GEN_C:$(BUILD)/gen/%=$(BUILD)/$1/gen/%.o)
	@rm -f $$@ && ar rcs $$@.new $$^ && mv $$@.new $$@

$(BUILD)/$1/unit/%: $(BUILD)/$1/tests/unit/%.c.o $(BUILD)/$1/tests/unit/%.runner.o \
                    $(call objects,$1,$(UNIT_AUX)) $(BUILD)/$1/unity/unity.c.o \
                    $(BUILD)/$1/libkcedge.a $(BUILD)/$1/libkincal.a
	@mkdir -p $$(@D)
	$$(Q)$3 $4 $$^ -Wl,--as-needed -llcm -lm -o $$@

-include $(patsubst %.o,%.d,$(call objects,$1,$(CORE_SRC) $(LCM_SRC) $(UNITS) $(UNIT_AUX) $(GND_SRC)))
endef

$(eval $(call variant,rel,gcc,g++,-O2 -fcallgraph-info=su))
$(eval $(call variant,san,gcc,g++,-O1 $(SAN)))
$(eval $(call variant,cov,gcc,g++,-Og --coverage -fprofile-abs-path))
$(eval $(call variant,clang,$(CLANG),$(CLANGXX),-O2))
$(eval $(call variant,gnd,gcc,g++,-O3 -fno-semantic-interposition -DKC_GROUND))
.PHONY: FORCE

# Found through two pattern rules; kept, so that the next run does not build them again.
.SECONDARY: $(foreach v,rel san cov clang,$(foreach u,$(UNITS:%.c=%) $(UNIT_AUX:%.c=%),$(BUILD)/$v/$u.c.o $(BUILD)/$v/$u.runner.o)) \
            $(UNITS:tests/unit/%.c=$(BUILD)/runners/%.c)

# ---- products -----------------------------------------------------------------------------------------

.PHONY: core fsw tagdet build
build: core fsw tagdet messages ## everything that runs

core: $(BUILD)/libkincal.a $(BUILD)/libkincal.so $(BUILD)/kincal_cdef.h ## the flight core as a library, and the ground's build
core: $(BUILD)/libkincal_ground.so $(BUILD)/kincal_ground_cdef.h

$(BUILD)/libkincal.a: $(BUILD)/rel/libkincal.a
	@cp $< $@.new && mv $@.new $@

$(BUILD)/libkincal.so: $(call objects,rel,$(CORE_SRC))
	$(Q)echo "  LD  $@"; g++ -shared -Wl,-z,defs $^ -lm -o $@.new && mv $@.new $@

$(BUILD)/kincal_cdef.h: $(HEADERS) ground/cdef.py
	@mkdir -p $(@D)
	$(Q)$(PYTHON) ground/cdef.py $(LAYERS:%=fsw/%) > $@.new && mv $@.new $@

$(BUILD)/libkincal_ground.so: $(call objects,gnd,$(GND_SRC))
	$(Q)echo "  LD  $@"; gcc -shared -Wl,-z,defs $^ -lm -o $@.new && mv $@.new $@

$(BUILD)/kincal_ground_cdef.h: $(GND_HDRS) ground/cdef.py
	@mkdir -p $(@D)
	$(Q)$(PYTHON) ground/cdef.py -DKC_GROUND $(GND_DIRS) > $@.new && mv $@.new $@

fsw: $(BUILD)/kincal-fsw ## the flight process

$(BUILD)/kincal-fsw: $(call objects,rel,$(MAIN_SRC)) $(BUILD)/rel/libkcedge.a $(BUILD)/rel/libkincal.a
	$(Q)echo "  LD  $@"; g++ $^ -llcm -lm -o $@.new && mv $@.new $@

tagdet: $(BUILD)/kincal-tagdet ## the tag detector process

TAG_OBJ := $(call objects,rel,$(TAG_SRC))
TAG_FLAGS := $(WARN) -O2 -g -ffp-contract=off -isystem $(BUILD)/gen -isystem /usr/include/opencv4
$(BUILD)/rel/sim/tagdet/%.c.o: sim/tagdet/%.c $(STAMP)/messages
	@mkdir -p $(@D)
	$(Q)echo "  CC  $@"; gcc -std=c11 $(TAG_FLAGS) -MMD -MP -c $< -o $@
$(BUILD)/rel/sim/tagdet/%.cpp.o: sim/tagdet/%.cpp $(STAMP)/messages
	@mkdir -p $(@D)
	$(Q)echo "  CC  $@"; g++ -std=c++17 $(TAG_FLAGS) -MMD -MP -c $< -o $@
$(BUILD)/kincal-tagdet: $(TAG_OBJ) $(GEN_C:$(BUILD)/gen/%=$(BUILD)/rel/gen/%.o)
	$(Q)echo "  LD  $@"; g++ $^ -lapriltag -lopencv_calib3d -lopencv_imgcodecs -lopencv_imgproc -lopencv_core -llcm -lm \
	    -o $@.new && mv $@.new $@
-include $(TAG_OBJ:.o=.d)

# ---- tests --------------------------------------------------------------------------------------------

JUNIT  := $(BUILD)/junit
PYTEST := $(PY) -m pytest -q -rsfE -c tests/pytest.ini

$(BUILD)/runners/%.c: tests/unit/%.c tests/unit/runner.py
	@mkdir -p $(@D)
	@$(PYTHON) tests/unit/runner.py main $< > $@

unit-bins = $(UNITS:tests/unit/%.c=$(BUILD)/$1/unit/%)

.PHONY: unit unit-san oracle integration ground-test lint-test
unit: $(call unit-bins,rel) ## unit tests
	@$(PYTHON) tests/unit/runner.py run --junit $(JUNIT)/unit.xml $^

unit-san: $(call unit-bins,san) ## unit tests under ASan and UBSan
	@$(PYTHON) tests/unit/runner.py run --junit $(JUNIT)/unit-san.xml $^

oracle: core .venv/.stamp-dev ## the core's numbers against independent libraries
	$(PYTEST) tests/oracle --junitxml=$(JUNIT)/oracle.xml

integration: build .venv/.stamp-dev ## processes over LCM
	$(PYTEST) tests/integration --junitxml=$(JUNIT)/integration.xml

ground-test: build .venv/.stamp-dev ## the ground tool
	$(PYTEST) tests/ground --junitxml=$(JUNIT)/ground.xml

lint-test: .venv/.stamp-dev ## the checks find what they are there for
	$(PYTEST) tests/lint --junitxml=$(JUNIT)/lint.xml

.PHONY: test
test: setup ## everything a change has to pass, with a summary
	@rm -rf $(JUNIT)
	@$(PYTHON) tests/suite.py --junit $(JUNIT) --logs $(BUILD)/log \
	    unit unit-san oracle integration ground-test lint-test cov size heapcheck lint

# ---- measures of the flight core ----------------------------------------------------------------------

.PHONY: cov size heapcheck
MIN_LINES    := 95
MIN_BRANCHES := 90
MAX_STATIC   := 1048576
MAX_STACK    := 32768

cov: $(call unit-bins,cov) ## line and branch coverage of the core by the unit tests
	@find $(BUILD)/cov/fsw -name '*.gcda' -delete
	@$(PYTHON) tests/unit/runner.py run $^ > $(BUILD)/cov/run.txt || { cat $(BUILD)/cov/run.txt; exit 1; }
	@$(PYTHON) tests/lint/coverage.py --lines $(MIN_LINES) --branches $(MIN_BRANCHES) $(if $(V),--missed) \
	    $(call objects,cov,$(CORE_SRC))

size: $(call objects,rel,$(CORE_SRC) $(LCM_SRC)) ## static bytes by module and worst stack
	@$(PYTHON) tests/lint/footprint.py --max-static $(MAX_STATIC) --max-stack $(MAX_STACK) $^

heapcheck: $(BUILD)/libkincal.a ## fails when the core references a heap function
	@$(PYTHON) tests/lint/heap.py $<

# ---- lint ---------------------------------------------------------------------------------------------

C_ALL   := $(CORE_SRC) $(LCM_SRC) $(TAG_SRC) $(wildcard ground/native/*.c)
C_STYLE := $(C_ALL) $(UNITS) $(UNIT_AUX) $(wildcard fsw/*/*.h ground/native/*.h sim/tagdet/*.h tests/unit/*.h)
TIDY    := $(C_ALL:%=$(BUILD)/tidy/%.ok)

.PHONY: lint lint-clang lint-tidy lint-cppcheck lint-format lint-direction lint-python lint-types lint-layers \
        lint-generated lint-glossary
lint: lint-clang lint-direction lint-format lint-cppcheck lint-tidy lint-python lint-types lint-layers lint-generated lint-glossary ## all static checks

lint-clang: $(call objects,clang,$(CORE_SRC) $(LCM_SRC) $(UNITS) $(UNIT_AUX) $(wildcard ground/native/*.c)) ## clang, same warnings

lint-tidy: $(TIDY) ## clang-tidy
tidy-flags = $(if $(filter %.c,$1),-std=c11,-std=c++17 $(if $(filter fsw/%,$1),-fno-exceptions)) -DEIGEN_DONT_VECTORIZE \
    $(LAYERS:%=-Ifsw/%) -Iground/native -isystem /usr/include/eigen3 -isystem $(BUILD)/gen -isystem /usr/include/opencv4
$(BUILD)/tidy/%.ok: % .clang-tidy $(wildcard fsw/*/*.h ground/native/*.h) $(STAMP)/messages | $(STAMP)/apt-test
	@mkdir -p $(@D)
	$(Q)echo "  TIDY $<"; clang-tidy-19 --quiet $< -- $(call tidy-flags,$<) 2>$@.err || { cat $@.err; exit 1; }
	@touch $@

# uninitvar is off: cppcheck 2.10 does not see arrays filled through a pointer to their struct's member; gcc,
# clang-tidy and the sanitizers look for the same. -UKC_GROUND: flight's limits, which the messages have too.
lint-cppcheck: | $(STAMP)/apt-test $(STAMP)/messages ## cppcheck
	@mkdir -p $(BUILD)/cppcheck
	$(Q)cppcheck --quiet --error-exitcode=1 --inline-suppr --enable=warning,performance,portability \
	    --std=c11 --std=c++17 -UKC_GROUND --cppcheck-build-dir=$(BUILD)/cppcheck --suppress=missingIncludeSystem --suppress=uninitvar \
	    $(LAYERS:%=-Ifsw/%) -Iground/native -I$(BUILD)/gen --suppress='*:$(BUILD)/gen/*' $(C_ALL)

lint-format: | $(STAMP)/apt-test ## C and C++ lay-out
	@for f in $(C_STYLE); do clang-format-19 $$f | cmp -s - $$f || echo "$$f: not laid out: run make format"; done \
	    | tee $(BUILD)/format.txt; test ! -s $(BUILD)/format.txt

lint-direction: ## includes and imports point the right way
	$(Q)$(PYTHON) tests/lint/direction.py

lint-glossary: ## one vocabulary, every term in docs/GLOSSARY.md, links lead somewhere
	$(Q)$(PYTHON) tests/lint/glossary.py

lint-python: | .venv/.stamp-dev ## ruff: rules and lay-out
	$(Q).venv/bin/ruff check --output-format=concise --quiet --config tests/ruff.toml ground sim tests
	$(Q).venv/bin/ruff format --quiet --check --config tests/ruff.toml ground sim tests || \
	    { .venv/bin/ruff format --check --config tests/ruff.toml ground sim tests; exit 1; }

lint-types: | .venv/.stamp-dev ## mypy, strict, over the ground tool and the simulator
	$(Q).venv/bin/mypy --config-file tests/mypy.ini ground/kincal sim/kincal_sim

lint-layers: | .venv/.stamp-dev ## import-linter: Python packages import downwards
	$(Q)PYTHONPATH=ground:sim .venv/bin/lint-imports --config tests/layers.ini --cache-dir $(BUILD)/import-linter

lint-generated: core messages .venv/.stamp-dev ## generated files are what their sources say
	$(Q)$(PYTHON) tests/lint/events.py --check
	$(Q)$(PY) ground/gen_docs.py --check
	$(Q)$(PY) ground/stubs.py --check
	$(Q)$(PY) ground/message_stubs.py --check
	$(Q)$(PY) tests/lint/tables.py

.PHONY: format dict docs stubs tables pictures
format: $(STAMP)/apt-test .venv/.stamp-dev ## lay out C, C++ and Python
	clang-format-19 -i $(C_STYLE)
	.venv/bin/ruff check --quiet --fix-only --select I --config tests/ruff.toml ground sim tests
	.venv/bin/ruff format --quiet --config tests/ruff.toml ground sim tests

dict: ## docs/EVENTS.md from the event list
	$(PYTHON) tests/lint/events.py

docs: dict core messages .venv/.stamp stubs ## the generated parts of docs/
	$(PY) ground/gen_docs.py

stubs: core .venv/.stamp ## types of the flight core for mypy
	$(PY) ground/stubs.py
	$(PY) ground/message_stubs.py

tables: core .venv/.stamp ## tables/bin from tables/src
	.venv/bin/kincal table build tables/src tables/bin

pictures: setup build ## docs/img made again: the sheet of a run through pixels, the tutorial's figures
	.venv/bin/kincal run paper --accept ground --out $(BUILD)/pictures
	cp $(BUILD)/pictures/summary.png docs/img/run.png
	$(PY) ground/gen_tutorial.py

# ---- running ------------------------------------------------------------------------------------------

.PHONY: demo hil bench-samples blind montecarlo occlusion real halves
demo: setup-demo build ## the paper's error set through pixels; picture and report in build/demo
	.venv/bin/kincal run sim/scenarios/paper.toml --accept ground --out $(BUILD)/demo

hil: setup build ## the scenarios as separate processes at real-time pace (URL=... for another LCM network)
	.venv/bin/python -m kincal_sim.hil $(if $(URL),--url $(URL))

bench-samples: setup build ## held-out error against number of poses, for all acquisitions
	.venv/bin/python tests/bench/samples.py
	.venv/bin/python tests/bench/samples.py --space tables/bin/space.tbl

blind: setup core ## sealed hidden effects: what the workbench finds, and whether its probabilities are honest
	.venv/bin/python tests/bench/blind.py

montecarlo: setup core ## thousands of recalibrations of wrong arms: contacts, unverified commands, how they end (RUNS, OUTSIDE, SEED)
	.venv/bin/python tests/bench/montecarlo.py $(if $(RUNS),--runs $(RUNS)) $(if $(OUTSIDE),--outside $(OUTSIDE)) $(if $(SEED),--seed $(SEED))

occlusion: setup core ## drawn frames against the search's verdict on what the arm hides
	.venv/bin/python tests/bench/occlusion.py

real: setup core ## measured sets of real arms: what the diagnosis names and gains (SETS=folder, ONLY=names, JSON=file)
	.venv/bin/python tests/bench/real.py $(SETS) $(if $(ONLY),--only $(ONLY)) $(if $(JSON),--json $(JSON))

halves: setup core ## measured sets of real arms: the same answer on random halves, silence on permuted residuals (SETS, ONLY)
	.venv/bin/python tests/bench/halves.py $(SETS) $(if $(ONLY),--only $(ONLY))

# ---- tidying ------------------------------------------------------------------------------------------

.PHONY: clean distclean
clean: ## delete what was built; keep the downloads
	rm -rf $(filter-out $(BUILD)/unity $(STAMP),$(wildcard $(BUILD)/*))
	rm -f $(STAMP)/messages

distclean: ## delete the downloads too
	rm -rf $(BUILD) .venv
